/* How an axis goes through a communication step: internal steps, and the commands on their way. */
#ifndef AXIS_H
#define AXIS_H

#if EXCHANGE
/* Under an outside solver: modes as the values ask for. */
static void settle_modes(State *s)
{
    /* A body that comes to rest may hold the other: two bodies need a few rounds. */
    for (int i = 0; i < 8; ++i)
        if (settle(s->slot + FIRST_STATE, s->slot + FIRST_PARAMETER, s->slot + FIRST_KNOWN, s->slot[COMMAND]) == 0.0)
            break;
    s->settled = s->slot[COMMAND];
}

static int is_unsettled(const State *s)
{
    const double *x = s->slot + FIRST_STATE;
    return s->slot[COMMAND] != s->settled || x[MARGIN_MOTOR] < 0.0 || x[MARGIN_LINK] < 0.0;
}
#endif

/* What follows from other values: the state before the start, rates, and what the sensor reads. */
static void refresh(State *s)
{
    double *x = s->slot + FIRST_STATE;
    int before = s->mode == MADE || s->mode == INITIALIZING;
    if (before) {
        for (size_t i = 0; i < STATES; ++i) x[i] = 0.0;
        x[POSITION] = s->slot[POSITION_START];
        x[VELOCITY] = x[MOTOR_VELOCITY] = s->slot[VELOCITY_START];
        x[TIME] = s->slot[TIME_START];
    }
#if EXCHANGE
    if (s->exchange) {
        x[TIME] = s->now - s->begin + s->slot[TIME_START];
        if (before) settle_modes(s);
        rates(x, s->slot + FIRST_PARAMETER, s->slot + FIRST_KNOWN, s->slot[COMMAND]);
    }
#endif
    s->slot[MEASURED] = x[POSITION] + sensor(x[POSITION], x[GAP], s->slot + FIRST_PARAMETER);
    s->stale = 0;
}

/* Go on by a span; `d` holds the slopes of all slots, or is NULL where nobody asks for them. */
static int move_pieces(Instance *me, double *slot, double *d, double command, double d_command, double span, double d_span)
{
    double pieces = floor(span / LONGEST_STEP + ROUND);
    if (pieces < 1.0) pieces = 1.0;
    if (pieces > 1e9) return refuse(me, "a step of %.9g s is too long: give shorter ones", span);
    double h = span / pieces, *x = slot + FIRST_STATE, *p = slot + FIRST_PARAMETER, *k = slot + FIRST_KNOWN;
    for (long i = 0, n = (long)pieces; i < n; ++i) {
        double left;
        if (d == NULL)
            step(x, p, k, command, h);
        else
            step_t(command, d_command, h, d_span / pieces, x, d + FIRST_STATE, p, d + FIRST_PARAMETER, k, &left);
    }
    return 1;
}

#if DELAY_CAPACITY
/* Commands on their way, oldest first, and the moments at which they were given. */
static void leave_line(double *slot, double *d, size_t i)
{
    size_t behind = (size_t)slot[DELAY_COUNT] - i - 1;
    memmove(slot + DELAY_TIME + i, slot + DELAY_TIME + i + 1, behind * sizeof *slot);
    memmove(slot + DELAY_VALUE + i, slot + DELAY_VALUE + i + 1, behind * sizeof *slot);
    if (d != NULL) memmove(d + DELAY_VALUE + i, d + DELAY_VALUE + i + 1, behind * sizeof *d);
    slot[DELAY_COUNT] -= 1.0;
}

/* Join the two neighbours that together lasted shortest, to their mean over that time. */
static void make_room(double *slot, double *d, double now)
{
    double *time = slot + DELAY_TIME, *value = slot + DELAY_VALUE;
    size_t best = 0;
    double shortest = HUGE_VAL;
    for (size_t i = 0; i + 1 < DELAY_CAPACITY; ++i) {
        double lasted = (i + 2 < DELAY_CAPACITY ? time[i + 2] : now) - time[i];
        if (lasted < shortest) {
            shortest = lasted;
            best = i;
        }
    }
    double share = shortest > 0.0 ? (time[best + 1] - time[best]) / shortest : 0.0;
    /* The later one of the two stays, in the name of both. */
    value[best + 1] = share * value[best] + (1.0 - share) * value[best + 1];
    time[best + 1] = time[best];
    if (d != NULL) {
        double *slope = d + DELAY_VALUE + best;
        slope[1] = share * slope[0] + (1.0 - share) * slope[1];
    }
    leave_line(slot, d, best);
}

static int go_on(Instance *me, double *slot, double *d, double span)
{
    double delay = slot[DELAY], d_now = 0.0;
    double now = slot[FIRST_STATE + TIME], end = now + span;
    double slack = (1.0 - ROUND) * LONGEST_STEP; /* no pieces that exist by rounding only */
    if (slot[DELAY_COUNT] >= DELAY_CAPACITY) make_room(slot, d, now);
    size_t last = (size_t)slot[DELAY_COUNT];
    slot[DELAY_TIME + last] = now;
    slot[DELAY_VALUE + last] = slot[COMMAND];
    if (d != NULL) d[DELAY_VALUE + last] = d[COMMAND];
    slot[DELAY_COUNT] += 1.0;
    while (now < end) {
        while (slot[DELAY_COUNT] > 0.0 && slot[DELAY_TIME] + delay <= now + slack) {
            slot[ACTING] = slot[DELAY_VALUE];
            if (d != NULL) d[ACTING] = d[DELAY_VALUE];
            leave_line(slot, d, 0);
        }
        double until = end, d_until = 0.0;
        if (slot[DELAY_COUNT] > 0.0 && slot[DELAY_TIME] + delay < end - slack) {
            until = slot[DELAY_TIME] + delay;
            if (d != NULL) d_until = d[DELAY];
        }
        double d_acting = d == NULL ? 0.0 : d[ACTING];
        if (!move_pieces(me, slot, d, slot[ACTING], d_acting, until - now, d_until - d_now)) return 0;
        now = until;
        d_now = d_until;
    }
    return 1;
}
#else
static int go_on(Instance *me, double *slot, double *d, double span)
{
    return move_pieces(me, slot, d, slot[COMMAND], d == NULL ? 0.0 : d[COMMAND], span, 0.0);
}
#endif

static int move(Instance *me, double span) { return go_on(me, me->state.slot, NULL, span); }

static int differentiate(Instance *me, double *d)
{
    const State *s = &me->state;
    double slot[SLOTS], *dx = d + FIRST_STATE;
    memcpy(slot, s->slot, sizeof slot);
    if (s->mode == MADE || s->mode == INITIALIZING) {
        for (size_t i = 0; i < STATES; ++i) dx[i] = 0.0;
        dx[POSITION] = d[POSITION_START];
        dx[VELOCITY] = dx[MOTOR_VELOCITY] = d[VELOCITY_START];
    } else if (!s->exchange) {
        if (s->span <= 0.0) return refuse(me, "there was no communication step yet whose derivatives could be given");
        memcpy(slot, s->last, sizeof slot);
        if (!go_on(me, slot, d, s->span)) return 0;
    }
    double slope;
#if EXCHANGE
    if (s->exchange)
        rates_t(slot[COMMAND], d[COMMAND], slot + FIRST_STATE, dx, slot + FIRST_PARAMETER, d + FIRST_PARAMETER,
                slot + FIRST_KNOWN, &slope);
#endif
    sensor_t(slot[FIRST_STATE + POSITION], dx[POSITION], slot[FIRST_STATE + GAP], dx[GAP], slot + FIRST_STATE, dx, slot + FIRST_PARAMETER,
             d + FIRST_PARAMETER, slot + FIRST_KNOWN, &slope);
    d[MEASURED] = dx[POSITION] + slope;
    return 1;
}

#if DELAY_CAPACITY
static int is_count(double number) { return number >= 0.0 && number <= DELAY_CAPACITY && number == floor(number); }
#endif

static int is_sound(const Instance *me, const State *s)
{
    (void)me;
#if DELAY_CAPACITY
    if (!is_count(s->slot[DELAY_COUNT]) || !is_count(s->last[DELAY_COUNT])) return 0;
#endif
    return s->span >= 0.0 && s->span < 1e9;
}

#endif

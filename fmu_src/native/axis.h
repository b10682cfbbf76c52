/* How an axis goes through a communication step: internal steps, and the commands on their way. */
#ifndef AXIS_H
#define AXIS_H

#if EXCHANGE
/* Under an outside solver: modes as the values ask for, then rates and margins. */
static int settle_modes(State *s)
{
    int changed = 0;
    /* A body that comes to rest may hold the other: two bodies need a few rounds. */
    for (int i = 0; i < 8; ++i) {
        if (settle(s->slot + FIRST_STATE, s->slot + FIRST_PARAMETER, s->slot + FIRST_KNOWN, s->slot[COMMAND]) == 0.0)
            break;
        changed = 1;
    }
    return changed;
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
    }
#if EXCHANGE
    if (s->exchange) {
        x[TIME] = s->now - s->begin;
        if (before) settle_modes(s);
        rates(x, s->slot + FIRST_PARAMETER, s->slot + FIRST_KNOWN, s->slot[COMMAND]);
    }
#endif
    s->slot[MEASURED] = x[POSITION] + sensor(x[POSITION], x[GAP], s->slot + FIRST_PARAMETER);
    s->stale = 0;
}

static int move_pieces(Instance *me, double command, double span)
{
    double *slot = me->state.slot;
    double pieces = floor(span / LONGEST_STEP + ROUND);
    if (pieces < 1.0) pieces = 1.0;
    if (pieces > 1e9) return refuse(me, "a step of %.9g s is too long: give shorter ones", span);
    double h = span / pieces;
    for (long i = 0, n = (long)pieces; i < n; ++i)
        step(slot + FIRST_STATE, slot + FIRST_PARAMETER, slot + FIRST_KNOWN, command, h);
    return 1;
}

#if DELAY_CAPACITY
/* Commands on their way, oldest first, and the moments at which they were given. */
static void leave_line(double *slot, size_t i)
{
    size_t behind = (size_t)slot[DELAY_COUNT] - i - 1;
    memmove(slot + DELAY_TIME + i, slot + DELAY_TIME + i + 1, behind * sizeof *slot);
    memmove(slot + DELAY_VALUE + i, slot + DELAY_VALUE + i + 1, behind * sizeof *slot);
    slot[DELAY_COUNT] -= 1.0;
}

/* Join the two neighbours that together lasted shortest, to their mean over that time. */
static void make_room(double *slot, double now)
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
    value[best] = share * value[best] + (1.0 - share) * value[best + 1];
    double joined_time = time[best], joined_value = value[best];
    leave_line(slot, best);
    time[best] = joined_time;
    value[best] = joined_value;
}

static int move(Instance *me, double span)
{
    double *slot = me->state.slot, delay = slot[DELAY];
    double now = slot[FIRST_STATE + TIME], end = now + span;
    double slack = (1.0 - ROUND) * LONGEST_STEP; /* no pieces that exist by rounding only */
    if (slot[DELAY_COUNT] >= DELAY_CAPACITY) make_room(slot, now);
    slot[DELAY_TIME + (size_t)slot[DELAY_COUNT]] = now;
    slot[DELAY_VALUE + (size_t)slot[DELAY_COUNT]] = slot[COMMAND];
    slot[DELAY_COUNT] += 1.0;
    while (now < end) {
        while (slot[DELAY_COUNT] > 0.0 && slot[DELAY_TIME] + delay <= now + slack) {
            slot[ACTING] = slot[DELAY_VALUE];
            leave_line(slot, 0);
        }
        double until = end;
        if (slot[DELAY_COUNT] > 0.0 && slot[DELAY_TIME] + delay < end - slack) until = slot[DELAY_TIME] + delay;
        if (!move_pieces(me, slot[ACTING], until - now)) return 0;
        now = until;
    }
    return 1;
}
#else
static int move(Instance *me, double span)
{
    return move_pieces(me, me->state.slot[COMMAND], span);
}
#endif

static int is_sound(const Instance *me, const State *s)
{
    (void)me, (void)s;
#if DELAY_CAPACITY
    if (!(s->slot[DELAY_COUNT] >= 0.0 && s->slot[DELAY_COUNT] <= DELAY_CAPACITY)) return 0;
#endif
    return 1;
}

#endif

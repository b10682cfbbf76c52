/* How a controller goes through a communication step: it reads at its own ticks.
 *
 * What it computes from one reading goes out at the next tick, so no output follows an input at once, and every
 * master gives the same result.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

/* What is remembered stands behind FIRST_STATE: these three, the observer, the memory, the commands under way. */
enum { ELAPSED, TICK, PENDING, OBSERVER };

static void refresh(State *s)
{
    if (s->mode == MADE || s->mode == INITIALIZING) {
        for (size_t i = 0; i < STATES; ++i) s->slot[FIRST_STATE + i] = 0.0;
        s->slot[OUTPUT] = 0.0;
    }
    s->stale = 0;
}

static int move(Instance *me, double span)
{
    double *slot = me->state.slot, *held = slot + FIRST_STATE, *in = slot + FIRST_INPUT;
    double *x = held + OBSERVER, *m = x + OBSERVER_STATES, *q = m + MEMORY;
    double y[OBSERVER_STATES], p[PARAMETERS], end = held[ELAPSED] + span;
    if (span / SAMPLE_TIME > 1e9) return refuse(me, "a step of %.9g s is too long: give shorter ones", span);
    memcpy(p, slot + FIRST_PARAMETER, sizeof p);
    if (m[STARTED] != 0.0) {
        /* Parameters may have changed under way: the torque that the observer has learnt stays on top. */
        m[NOMINAL] = p[OFFSET];
        p[OFFSET] += m[DISTURBANCE];
    }
    while (held[TICK] * SAMPLE_TIME < end - 1e-6 * SAMPLE_TIME) {
        slot[OUTPUT] = held[PENDING];
        held[PENDING] = sample(x, y, m, q, p, slot + FIRST_SETTING, slot + FIRST_KNOWN, in[0], in[1], in[2], in[3]);
        held[TICK] += 1.0;
    }
    if (held[TICK] * SAMPLE_TIME <= end + 1e-6 * SAMPLE_TIME) slot[OUTPUT] = held[PENDING];
    held[ELAPSED] = end;
    return 1;
}

static int is_sound(const Instance *me, const State *s)
{
    const double *held = s->slot + FIRST_STATE;
    (void)me;
    for (size_t i = 0; i < sizeof fixed / sizeof *fixed; ++i)
        if (s->slot[fixed[i]] != compiled_in[fixed[i]]) return 0;
    return held[ELAPSED] >= 0.0 && held[ELAPSED] < 1e12 && fabs(held[TICK] * SAMPLE_TIME - held[ELAPSED]) < 2.0 * SAMPLE_TIME;
}

#endif

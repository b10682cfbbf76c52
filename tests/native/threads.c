/* Two instances of an exported axis, each stepped in a thread of its own, to be built with the thread sanitizer.
 *
 * threads RESOURCES: what one thread does to its instance may not be seen by the other: instances share no memory that is
 * written. Exits 1 where the two, given the same commands, end at different positions, and with the sanitizer's own code
 * where it saw a race.
 */
#include "calls.h"

#include <pthread.h>

#define STEPS 3000
#define POSITION_OUT 1 /* value reference of position, behind the input */

typedef struct {
    const char *resources;
    int good;
    double position;
} Thread;

static void *step_through(void *given)
{
    Thread *me = given;
    double h = 0.002, begun = 0.0;
    me->good = 1;
    for (int round = 0; round < 2; ++round) {
        Axis a = NEW(TOKEN, me->resources);
        if (a == NULL || BEGIN(a, 0.0) != 0 || READY(a) != 0) {
            me->good = 0;
            return NULL;
        }
        void *saved = NULL;
        for (int i = 0; i < STEPS; ++i) {
            if (i == STEPS / 2) me->good &= SAVE(a, &saved) == 0;
            me->good &= SET(a, 0, 40.0 * sin(0.01 * i)) == 0 && STEP(a, begun + h * i, h) == 0;
            me->good &= GET(a, POSITION_OUT, &me->position) == 0;
            /* Refusals write a sentence; each into memory of its own. */
            if (i % 500 == 0) me->good &= SET(a, VARIABLES, 1.0) != 0;
        }
        me->good &= RESTORE(a, saved) == 0 && FORGET(a, &saved) == 0 && RESET(a) == 0;
        FREE(a);
    }
    return NULL;
}

int main(int count, char **arguments)
{
    if (count < 2) return 2;
    pthread_t made[2];
    Thread of[2] = {{arguments[1], 0, 0.0}, {arguments[1], 0, 0.0}};
    for (int i = 0; i < 2; ++i)
        if (pthread_create(&made[i], NULL, step_through, &of[i]) != 0) return 2;
    for (int i = 0; i < 2; ++i) pthread_join(made[i], NULL);
    printf("%.17g %.17g\n", of[0].position, of[1].position);
    return of[0].good && of[1].good && of[0].position == of[1].position ? 0 : 1;
}

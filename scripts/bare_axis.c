/* The bare loop: the physics of an exported axis with nothing of FMI around it; what `bench.py` measures the FMU against.
 *
 * bare_axis PIECES REPEAT STEP: reads commands from the standard input, one a line, each held for STEP seconds in
 * PIECES internal steps. Prints the seconds of processor time that one command takes, the fastest of REPEAT runs.
 */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <math.h>

/* What model.h expects of the plumbing. */
typedef enum { NEVER, BEFORE_START, ANY_TIME } Settable;
typedef struct {
    const char *name;
    size_t slot;
    double least, most;
    Settable settable;
    int differentiable;
} Variable;

#include "model.h"

enum { MOST = 100000 };
static double command[MOST];

int main(int argc, char **argv)
{
    (void)variables;
    if (argc < 4) return 2;
    int count = 0, pieces = atoi(argv[1]), repeat = atoi(argv[2]);
    while (count < MOST && scanf("%lf", &command[count]) == 1) ++count;
    double h = atof(argv[3]) / pieces, best = 1e9, last = 0.0;
    for (int r = 0; r < repeat; ++r) {
        double slot[SLOTS];
        for (int i = 0; i < SLOTS; ++i) slot[i] = compiled_in[i];
        clock_t begin = clock();
        for (int i = 0; i < count; ++i)
            for (int j = 0; j < pieces; ++j)
                step(slot + FIRST_STATE, slot + FIRST_PARAMETER, slot + FIRST_KNOWN, command[i], h);
        double took = (double)(clock() - begin) / CLOCKS_PER_SEC / count;
        if (took < best) best = took;
        last = slot[FIRST_STATE] + sensor(slot[FIRST_STATE], slot[FIRST_STATE + 2], slot + FIRST_PARAMETER);
    }
    fprintf(stderr, "%g\n", last); /* so that no compiler leaves the loop out */
    printf("%.17g\n", best);
    return 0;
}

/* A host without Python: loads the library of a co-simulation FMU and drives it.
 *
 * master LIBRARY 2|3 TOKEN RESOURCES STEP [REPEAT]
 * Reads commands from the standard input, one a line, each held for STEP seconds. Value references are those of an
 * exported axis: 0 the input, 1 to 3 the outputs. Prints the outputs after every step, or, with REPEAT, the seconds
 * that one step takes on average, the fastest of REPEAT runs (set + step + get).
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef _WIN32
#include <windows.h>
#define LOAD(path) (void *)LoadLibraryA(path)
#define FIND(library, name) (void *)GetProcAddress((HMODULE)library, name)
#else
#include <dlfcn.h>
#define LOAD(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif
#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

enum { MOST = 100000 };
static double command[MOST];
static void *library;

static void *find(const char *name)
{
    void *found = FIND(library, name);
    if (found == NULL) {
        fprintf(stderr, "%s is not in the library\n", name);
        exit(2);
    }
    return found;
}

static void hear2(void *e, fmi2String name, fmi2Status s, fmi2String category, fmi2String message, ...)
{
    (void)e, (void)name, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}

static void hear3(void *e, fmi3Status s, fmi3String category, fmi3String message)
{
    (void)e, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}

/* Processor time: other programs do not count. */
static double now(void) { return (double)clock() / CLOCKS_PER_SEC; }

static void check(int good, const char *what)
{
    if (!good) {
        fprintf(stderr, "%s failed\n", what);
        exit(1);
    }
}

static void print(const double *y) { printf("%.17g %.17g %.17g\n", y[0], y[1], y[2]); }

static double run2(const char *token, const char *resources, double h, int count, int quiet)
{
    static const fmi2CallbackFunctions callbacks = {hear2, calloc, free, NULL, NULL};
    static const fmi2ValueReference in[] = {0}, out[] = {1, 2, 3};
    fmi2SetRealTYPE *set = (fmi2SetRealTYPE *)find("fmi2SetReal");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)find("fmi2GetReal");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)find("fmi2DoStep");
    fmi2Component c = ((fmi2InstantiateTYPE *)find("fmi2Instantiate"))("axis", fmi2CoSimulation, token, resources,
                                                                       &callbacks, 0, 0);
    check(c != NULL, "fmi2Instantiate");
    check(((fmi2SetupExperimentTYPE *)find("fmi2SetupExperiment"))(c, 0, 0, 0, 0, 0) == fmi2OK, "setup");
    check(((fmi2EnterInitializationModeTYPE *)find("fmi2EnterInitializationMode"))(c) == fmi2OK, "initialization");
    check(((fmi2ExitInitializationModeTYPE *)find("fmi2ExitInitializationMode"))(c) == fmi2OK, "initialization");
    double y[3], begin = now();
    int good = 1;
    for (int i = 0; i < count; ++i) {
        good &= set(c, in, 1, &command[i]) == fmi2OK;
        good &= step(c, i * h, h, 1) == fmi2OK;
        good &= get(c, out, 3, y) == fmi2OK;
        if (!quiet) print(y);
    }
    double took = now() - begin;
    check(good, "a step");
    ((fmi2FreeInstanceTYPE *)find("fmi2FreeInstance"))(c);
    return took / count;
}

static double run3(const char *token, const char *resources, double h, int count, int quiet)
{
    static const fmi3ValueReference in[] = {0}, out[] = {1, 2, 3};
    fmi3SetFloat64TYPE *set = (fmi3SetFloat64TYPE *)find("fmi3SetFloat64");
    fmi3GetFloat64TYPE *get = (fmi3GetFloat64TYPE *)find("fmi3GetFloat64");
    fmi3DoStepTYPE *step = (fmi3DoStepTYPE *)find("fmi3DoStep");
    fmi3Instance c = ((fmi3InstantiateCoSimulationTYPE *)find("fmi3InstantiateCoSimulation"))(
        "axis", token, resources, 0, 0, 0, 0, NULL, 0, NULL, hear3, NULL);
    check(c != NULL, "fmi3InstantiateCoSimulation");
    check(((fmi3EnterInitializationModeTYPE *)find("fmi3EnterInitializationMode"))(c, 0, 0, 0, 0, 0) == fmi3OK,
          "initialization");
    check(((fmi3ExitInitializationModeTYPE *)find("fmi3ExitInitializationMode"))(c) == fmi3OK, "initialization");
    double y[3], reached, begin = now();
    fmi3Boolean event, finish, early;
    int good = 1;
    for (int i = 0; i < count; ++i) {
        good &= set(c, in, 1, &command[i], 1) == fmi3OK;
        good &= step(c, i * h, h, 1, &event, &finish, &early, &reached) == fmi3OK;
        good &= get(c, out, 3, y, 3) == fmi3OK;
        if (!quiet) print(y);
    }
    double took = now() - begin;
    check(good, "a step");
    ((fmi3FreeInstanceTYPE *)find("fmi3FreeInstance"))(c);
    return took / count;
}

int main(int argc, char **argv)
{
    if (argc < 6) return 2;
    int count = 0;
    while (count < MOST && scanf("%lf", &command[count]) == 1) ++count;
    library = LOAD(argv[1]);
    check(library != NULL, "loading the library");
    double h = strtod(argv[5], NULL), best = 1e9;
    double (*run)(const char *, const char *, double, int, int) = argv[2][0] == '2' ? run2 : run3;
    int repeat = argc > 6 ? atoi(argv[6]) : 0;
    if (repeat == 0) run(argv[3], argv[4], h, count, 0);
    for (int i = 0; i < repeat; ++i) {
        double took = run(argv[3], argv[4], h, count, 1);
        if (took < best) best = took;
    }
    if (repeat > 0) printf("%.17g\n", best);
    return 0;
}

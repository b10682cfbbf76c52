/* Calls an exported axis or controller as no importer should, to be built with sanitizers together with its sources.
 *
 * abuse RESOURCES: prints the position after each phase; exits 1 where something was accepted that must not be, or
 * memory taken where none may be. Start values that cannot be read are written into the folder `misread`.
 */
#include "calls.h"

#if FMI == 2
#define OK fmi2OK
#else
#define OK fmi3OK
#endif
#define BAD(call) expect((call) != OK, #call)
#define GOOD(call) expect((call) == OK, #call)

static int failures;

static void expect(int held, const char *what)
{
    if (!held) {
        printf("not so: %s\n", what);
        failures = 1;
    }
}

/* How often memory was taken, by whomever. */
static unsigned taken;

static void count_taken(const volatile void *memory, size_t size)
{
    (void)memory, (void)size;
    ++taken;
}

static void count_nothing(const volatile void *memory) { (void)memory; }

/* Of the address sanitizer's run-time; not every compiler brings its header. */
int __sanitizer_install_malloc_and_free_hooks(void (*taking)(const volatile void *, size_t),
                                              void (*giving)(const volatile void *));

/* What the standard has and this FMU has not. */
static void ask_for_what_is_not_offered(Axis a)
{
#if FMI == 2
    fmi2Integer integer = 0;
    fmi2Boolean flag = 0, finish = 0;
    fmi2String text = "";
    fmi2Real real = 0.0;
    fmi2Status outcome = fmi2OK;
    fmi2ValueReference r = 0;
    expect(strcmp(fmi2GetVersion(), "2.0") == 0 && strcmp(fmi2GetTypesPlatform(), "default") == 0, "the version");
    GOOD(fmi2SetDebugLogging(a, 1, 0, NULL));
    GOOD(fmi2GetInteger(a, &r, 0, &integer));
    BAD(fmi2GetInteger(a, &r, 1, &integer));
    BAD(fmi2GetBoolean(a, &r, 1, &flag));
    BAD(fmi2GetString(a, &r, 1, &text));
    BAD(fmi2SetInteger(a, &r, 1, &integer));
    BAD(fmi2SetBoolean(a, &r, 1, &flag));
    BAD(fmi2SetString(a, &r, 1, &text));
    fmi2ValueReference none = VARIABLES;
    BAD(fmi2GetDirectionalDerivative(a, &r, 1, &none, 1, &real, &real));
    BAD(fmi2GetDirectionalDerivative(a, &none, 1, &r, 1, &real, &real));
    BAD(fmi2CancelStep(a));
    BAD(fmi2SetRealInputDerivatives(a, &r, 1, &integer, &real));
    BAD(fmi2GetRealOutputDerivatives(a, &r, 1, &integer, &real));
    GOOD(fmi2GetRealStatus(a, fmi2LastSuccessfulTime, &real));
    BAD(fmi2GetRealStatus(a, fmi2Terminated, &real));
    GOOD(fmi2GetBooleanStatus(a, fmi2Terminated, &flag));
    BAD(fmi2GetBooleanStatus(a, fmi2DoStepStatus, &flag));
    BAD(fmi2GetStatus(a, fmi2DoStepStatus, &outcome));
    BAD(fmi2GetIntegerStatus(a, fmi2DoStepStatus, &integer));
    BAD(fmi2GetStringStatus(a, fmi2PendingStatus, &text));
    GOOD(fmi2CompletedIntegratorStep(a, 1, &flag, &finish));
#else
    fmi3ValueReference r = 0;
    fmi3Boolean flag = 0;
    fmi3Float64 real = 0.0;
    fmi3UInt64 counter = 0;
    fmi3IntervalQualifier qualifier;
    size_t size = 0;
    fmi3Binary binary = NULL;
    expect(strcmp(fmi3GetVersion(), "3.0") == 0, "the version");
    GOOD(fmi3SetDebugLogging(a, 1, 0, NULL));
    expect(fmi3InstantiateScheduledExecution("axis", TOKEN, "", 0, 1, NULL, hear, NULL, NULL, NULL) == NULL, "clocks");
    expect(fmi3InstantiateScheduledExecution("axis", TOKEN, "", 0, 1, NULL, NULL, NULL, NULL, NULL) == NULL, "clocks");
    BAD(fmi3EnterConfigurationMode(a));
    BAD(fmi3ExitConfigurationMode(a));
    BAD(fmi3EnterStepMode(a));
#define NONE_OF(type)                                                                                                  \
    {                                                                                                                  \
        fmi3##type value = 0;                                                                                          \
        GOOD(fmi3Get##type(a, &r, 0, &value, 0));                                                                      \
        BAD(fmi3Get##type(a, &r, 1, &value, 1));                                                                       \
        BAD(fmi3Set##type(a, &r, 1, &value, 1));                                                                       \
    }
    NONE_OF(Float32)
    NONE_OF(Int8)
    NONE_OF(UInt8)
    NONE_OF(Int16)
    NONE_OF(UInt16)
    NONE_OF(Int32)
    NONE_OF(UInt32)
    NONE_OF(Int64)
    NONE_OF(UInt64)
    NONE_OF(Boolean)
    NONE_OF(String)
    BAD(fmi3GetBinary(a, &r, 1, &size, &binary, 1));
    BAD(fmi3SetBinary(a, &r, 1, &size, &binary, 1));
    BAD(fmi3GetClock(a, &r, 1, &flag));
    BAD(fmi3SetClock(a, &r, 1, &flag));
    BAD(fmi3GetShiftDecimal(a, &r, 1, &real));
    BAD(fmi3SetShiftDecimal(a, &r, 1, &real));
    BAD(fmi3SetIntervalDecimal(a, &r, 1, &real));
    BAD(fmi3GetIntervalDecimal(a, &r, 1, &real, &qualifier));
    BAD(fmi3GetShiftFraction(a, &r, 1, &counter, &counter));
    BAD(fmi3SetShiftFraction(a, &r, 1, &counter, &counter));
    BAD(fmi3SetIntervalFraction(a, &r, 1, &counter, &counter));
    BAD(fmi3GetIntervalFraction(a, &r, 1, &counter, &counter, &qualifier));
    BAD(fmi3ActivateModelPartition(a, r, 0.0));
    fmi3ValueReference none = VARIABLES;
    BAD(fmi3GetDirectionalDerivative(a, &r, 1, &none, 1, &real, 1, &real, 1));
    BAD(fmi3GetDirectionalDerivative(a, &none, 1, &r, 1, &real, 1, &real, 1));
    BAD(fmi3GetDirectionalDerivative(a, &r, 1, &r, 1, &real, 2, &real, 1));
    BAD(fmi3GetAdjointDerivative(a, &r, 1, &r, 1, &real, 1, &real, 1));
    BAD(fmi3GetOutputDerivatives(a, &r, 1, (fmi3Int32[]){1}, &real, 1));
    (void)fmi3GetNumberOfVariableDependencies(a, r, &size);
#endif
}

/* Start values that cannot be read: no instance, and nothing left behind. */
static void misread(void)
{
    static const char *const bad[] = {"nan\n", "", "\n", "x\n", "1e999\n", "1.0 2.0\n"};
    for (size_t i = 0; i <= sizeof bad / sizeof *bad; ++i) {
        FILE *file = fopen("misread/parameters.txt", "wb");
        if (file == NULL) exit(2);
        fprintf(file, "# start values\n\n%s", variables[0].name);
        if (i < sizeof bad / sizeof *bad) fprintf(file, " %s", bad[i]);
        for (int j = 0; i == sizeof bad / sizeof *bad && j < 5000; ++j) fputc("x\0%\xff"[j % 4], file);
        fclose(file);
        expect(NEW(TOKEN, i % 2 ? "misread" : "file:%6disread") == NULL, "start values that cannot be read are refused");
    }
}

static double run(Axis a, double *t, double h, int steps)
{
    double position = 0.0;
    unsigned before = taken;
    for (int i = 0; i < steps; ++i) {
        GOOD(SET(a, 0, 80.0 * sin(3.0 * *t)));
        GOOD(STEP(a, *t, h));
        *t += h;
    }
    GOOD(GET(a, 1, &position));
    expect(isfinite(position), "the position is finite");
    expect(taken == before, "no memory is taken in steps");
    return position;
}

/* The calls of an outside solver, in and out of turn, with states of any size. */
static void solve(const char *resources)
{
    double x[32] = {0.0}, rate[32], margin[32];
    Axis a = NEW_EXCHANGE(TOKEN, resources);
#if EXCHANGE
    if (a == NULL) exit(2);
    unsigned before = taken;
    BAD(TO_CONTINUOUS(a));
    BAD(UPDATE(a));
    GOOD(BEGIN(a, 0.0));
    GOOD(RATES(a, rate, CONTINUOUS_STATES));
    GOOD(READY(a));
    BAD(STEP(a, 0.0, 0.002));
    GOOD(UPDATE(a));
    GOOD(TO_CONTINUOUS(a));
    BAD(UPDATE(a));
    BAD(SET_TIME(a, NAN));
    BAD(GET_STATES(a, x, CONTINUOUS_STATES + 1));
    BAD(MARGINS(a, margin, INDICATORS + 1));
    GOOD(NOMINALS(a, rate, CONTINUOUS_STATES));
    BAD(NOMINALS(a, rate, CONTINUOUS_STATES + 1));
    BAD(SET_STATES(a, x, CONTINUOUS_STATES + 1));
    double t = 0.0, most[] = {1e-3, 1.0, 1e3, 1e300};
    for (int i = 0; i < 4000; ++i) {
        t += 1e-3;
        GOOD(SET_TIME(a, t));
        GOOD(SET(a, 0, 80.0 * sin(3.0 * t)));
        GOOD(GET_STATES(a, x, CONTINUOUS_STATES));
        GOOD(RATES(a, rate, CONTINUOUS_STATES));
        for (size_t j = 0; j < CONTINUOUS_STATES; ++j) x[j] += 1e-3 * rate[j];
        if (i % 500 == 499)
            for (size_t j = 0; j < CONTINUOUS_STATES; ++j) x[j] = (j % 2 ? -1.0 : 1.0) * most[i / 500 % 4];
        for (size_t j = 0; j < CONTINUOUS_STATES; ++j)
            if (!isfinite(x[j])) x[j] = 0.0;
        GOOD(SET_STATES(a, x, CONTINUOUS_STATES));
        GOOD(MARGINS(a, margin, INDICATORS));
        if (i % 7 == 0) {
            GOOD(TO_EVENTS(a));
            GOOD(UPDATE(a));
            GOOD(TO_CONTINUOUS(a));
        }
    }
    x[0] = NAN;
    BAD(SET_STATES(a, x, CONTINUOUS_STATES));
    GOOD(END(a));
    expect(taken == before, "an outside solver's calls take no memory");
    FREE(a);
#else
    (void)x, (void)rate, (void)margin;
    expect(a == NULL, "model exchange is refused where it is not offered");
    a = NEW(TOKEN, resources);
    BAD(RATES(a, rate, 1));
    BAD(SET_STATES(a, x, 1));
    BAD(SET_TIME(a, 0.0));
    FREE(a);
#endif
}

int main(int argc, char **argv)
{
    double value = 0.0, t = 0.0;
    setbuf(stdout, NULL);
    __sanitizer_install_malloc_and_free_hooks(count_taken, count_nothing);
    void *volatile some = malloc(1);
    free(some);
    expect(taken == 1, "it is seen when memory is taken");
    expect(NEW("{another}", NULL) == NULL, "a wrong token is refused");
    expect(NEW(NULL, NULL) == NULL, "no token is refused");
    char deep[9000];
    memset(deep, 'a', sizeof deep - 1);
    deep[sizeof deep - 1] = '\0';
    expect(NEW(TOKEN, deep) == NULL, "a path too long is refused");
    Axis a = NEW(TOKEN, "file:///no%2");
    expect(a == NULL, "a lost resource folder is refused: the values of the last update are there");
    expect(NEW(TOKEN, NULL) == NULL && NEW(TOKEN, "") == NULL, "no resource folder is refused");
    a = NEW(TOKEN, argc > 1 ? argv[1] : NULL);
    if (a == NULL) return 2;
    unsigned before = taken;
    BAD(STEP(a, 0.0, 0.01));
    BAD(READY(a));
    BAD(END(a));
    BAD(BEGIN(a, NAN));
    GOOD(BEGIN(a, 0.0));
    for (unsigned r = 0; r < VARIABLES + 5; ++r) {
        (void)GET(a, r, &value);
        BAD(SET(a, r, NAN));
        (void)SET(a, r, -1e300);
        (void)SET(a, r, 1e300);
    }
    BAD(SET(a, 0xffffffffu, 0.0));
    GOOD(RESET(a));
    GOOD(BEGIN(a, 0.0));
    GOOD(READY(a));
    BAD(READY(a));
    printf("%.9g\n", run(a, &t, 0.002, 1000));
    /* Steps so short that commands on their way must be joined. */
    printf("%.9g\n", run(a, &t, 1e-6, 3000));
    BAD(STEP(a, t - 0.1, 0.002));
    BAD(STEP(a, t + 0.1, 0.002));
    BAD(STEP(a, t, -0.002));
    BAD(STEP(a, t, INFINITY));
    BAD(STEP(a, NAN, 0.002));
    BAD(STEP(a, t, 1e300));
    GOOD(STEP(a, t, 0.0));
    ask_for_what_is_not_offered(a);
    for (unsigned r = 0; r < sizeof variables / sizeof *variables; ++r)
        if (variables[r].settable == BEFORE_START) BAD(SET(a, r, 0.0));
    expect(taken == before, "no memory is taken after an instance was made");

    void *saved = NULL, *other = NULL;
    size_t size = 0;
    double from = t;
    GOOD(SAVE(a, &saved));
    double first = run(a, &t, 0.002, 200);
    GOOD(SIZE(a, saved, &size));
    unsigned char *bytes = malloc(size);
    if (bytes == NULL) return 2;
    GOOD(PACK(a, saved, bytes, size));
    BAD(PACK(a, saved, bytes, size - 1));
    BAD(PACK(a, NULL, bytes, size));
    BAD(UNPACK(a, bytes, 3, &other));
    BAD(RESTORE(a, NULL));
    GOOD(UNPACK(a, bytes, size, &other));
    t = from;
    GOOD(RESTORE(a, other));
    expect(run(a, &t, 0.002, 200) == first, "a restored state continues identically");
    FORGET(a, &other);
    /* Any bytes behind a right token: continued without harm, or refused. */
    unsigned random = 1;
    for (int trial = 0; trial < 200; ++trial) {
        for (size_t i = sizeof TOKEN; i < size; ++i) {
            random = random * 1664525u + 1013904223u;
            bytes[i] = (unsigned char)(random >> 24);
        }
        if (trial % 2) { /* a mode and a line that pass, so that what is left is put to use */
            State kept;
            memcpy(&kept, bytes + sizeof TOKEN, sizeof kept);
            kept.mode = RUNNING;
            kept.exchange = 0;
            kept.now = 0.0;
#if DELAY_CAPACITY
            kept.slot[DELAY_COUNT] = DELAY_CAPACITY - trial % 3;
            kept.last[DELAY_COUNT] = DELAY_CAPACITY - trial % 5;
#endif
#if DERIVATIVES
            kept.span = 0.001 * (trial % 4);
#endif
#ifdef CONTROLLER_H
            for (size_t i = 0; i < sizeof fixed / sizeof *fixed; ++i) kept.slot[fixed[i]] = compiled_in[fixed[i]];
            kept.slot[FIRST_STATE + ELAPSED] = kept.slot[FIRST_STATE + TICK] = 0.0;
#endif
            memcpy(bytes + sizeof TOKEN, &kept, sizeof kept);
        }
        other = NULL;
        (void)UNPACK(a, bytes, size, &other);
        if (other != NULL && RESTORE(a, other) == 0) {
            (void)STEP(a, 0.0, 0.002);
            (void)GET(a, 3, &value);
            (void)SLOPE(a, 1, 4, &value);
        }
        FORGET(a, &other);
    }
#if DELAY_CAPACITY
    State kept;
    GOOD(PACK(a, saved, bytes, size));
    memcpy(&kept, bytes + sizeof TOKEN, sizeof kept);
    kept.slot[DELAY_COUNT] = 0.5;
    memcpy(bytes + sizeof TOKEN, &kept, sizeof kept);
    other = NULL;
    BAD(UNPACK(a, bytes, size, &other));
#endif
    free(bytes);
    GOOD(RESTORE(a, saved));
    t = from;
    expect(run(a, &t, 0.002, 200) == first, "a saved state outlives everything");
    FORGET(a, &saved);
    FORGET(a, &saved);
    GOOD(END(a));
    BAD(STEP(a, t, 0.002));
    BAD(SET(a, 0, 1.0));
    FREE(a);
    FREE(NULL);
    solve(argc > 1 ? argv[1] : NULL);
    misread();
    return failures;
}

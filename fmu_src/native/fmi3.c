/* FMI 3.0 over one instance. */
#include "fmi3Functions.h"
#include "instance.h"

static void tell(const Instance *me, const char *sentence)
{
    if (me->logger != NULL) ((fmi3LogMessageCallback)me->logger)(me->environment, fmi3Error, "logStatusError", sentence);
}

static fmi3Status status(int good) { return good ? fmi3OK : fmi3Error; }

static fmi3Status missing(fmi3Instance c, const char *what)
{
    return status(refuse(c, "%s is not offered by this FMU", what));
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

/* ---- life ---- */

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    (void)visible, (void)logging;
    return make(name, token, resources, 1, environment, (void (*)(void))log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)visible, (void)logging, (void)events, (void)early_return, (void)intermediate, (void)n, (void)update;
    return make(name, token, resources, 0, environment, (void (*)(void))log);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    if (log != NULL) log(environment, fmi3Error, "logStatusError", "this FMU has no clocks to schedule");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 time, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    return status(begin_at(c, time) && change_mode(c, MADE, INITIALIZING, "fmi3EnterInitializationMode"));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return status(start(c)); }
fmi3Status fmi3Terminate(fmi3Instance c) { return status(end(c)); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return missing(c, "fmi3EnterConfigurationMode"); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return missing(c, "fmi3ExitConfigurationMode"); }

fmi3Status fmi3Reset(fmi3Instance c)
{
    restart(c);
    return fmi3OK;
}

/* ---- values; `time` comes after the model's own variables ---- */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t m)
{
    if (m != n) return status(refuse(c, "%u values were asked for of %u variables", (unsigned)m, (unsigned)n));
    int good = 1;
    for (size_t i = 0; i < n; ++i) {
        if (vr[i] == CLOCK_REFERENCE) value[i] = ((const Instance *)c)->state.now;
        else good = get_value(c, vr[i], &value[i]) && good;
    }
    return status(good);
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[], size_t m)
{
    if (m != n) return status(refuse(c, "%u values were given for %u variables", (unsigned)m, (unsigned)n));
    int good = 1;
    for (size_t i = 0; i < n; ++i) good = set_value(c, vr[i], value[i]) && good;
    return status(good);
}

#define NO_VARIABLES(function, type)                                                                                   \
    fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type value[], size_t m)               \
    {                                                                                                                  \
        (void)vr, (void)value, (void)m;                                                                                \
        return n == 0 ? fmi3OK : missing(c, #function);                                                                \
    }
#define NO_VARIABLES_OF(type)                                                                                          \
    NO_VARIABLES(fmi3Get##type, fmi3##type)                                                                            \
    NO_VARIABLES(fmi3Set##type, const fmi3##type)
NO_VARIABLES_OF(Float32)
NO_VARIABLES_OF(Int8)
NO_VARIABLES_OF(UInt8)
NO_VARIABLES_OF(Int16)
NO_VARIABLES_OF(UInt16)
NO_VARIABLES_OF(Int32)
NO_VARIABLES_OF(UInt32)
NO_VARIABLES_OF(Int64)
NO_VARIABLES_OF(UInt64)
NO_VARIABLES_OF(Boolean)
NO_VARIABLES_OF(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary value[],
                         size_t m)
{
    (void)vr, (void)sizes, (void)value, (void)m;
    return n == 0 ? fmi3OK : missing(c, "fmi3GetBinary");
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary value[], size_t m)
{
    (void)vr, (void)sizes, (void)value, (void)m;
    return n == 0 ? fmi3OK : missing(c, "fmi3SetBinary");
}

/* ---- clocks: there are none ---- */

#define NO_CLOCKS(function, ...)                                                                                       \
    fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t n, __VA_ARGS__)                          \
    {                                                                                                                  \
        (void)vr, (void)first;                                                                                         \
        return n == 0 ? fmi3OK : missing(c, #function);                                                                \
    }
NO_CLOCKS(fmi3GetClock, fmi3Clock first[])
NO_CLOCKS(fmi3SetClock, const fmi3Clock first[])
NO_CLOCKS(fmi3GetShiftDecimal, fmi3Float64 first[])
NO_CLOCKS(fmi3SetShiftDecimal, const fmi3Float64 first[])
NO_CLOCKS(fmi3SetIntervalDecimal, const fmi3Float64 first[])

#define NO_CLOCK_PAIRS(function, first_type, second_type)                                                              \
    fmi3Status function(fmi3Instance c, const fmi3ValueReference vr[], size_t n, first_type first[],                   \
                        second_type second[])                                                                          \
    {                                                                                                                  \
        (void)vr, (void)first, (void)second;                                                                           \
        return n == 0 ? fmi3OK : missing(c, #function);                                                                \
    }
NO_CLOCK_PAIRS(fmi3GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
NO_CLOCK_PAIRS(fmi3GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_CLOCK_PAIRS(fmi3SetShiftFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCK_PAIRS(fmi3SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)vr, (void)counters, (void)resolutions, (void)qualifiers;
    return n == 0 ? fmi3OK : missing(c, "fmi3GetIntervalFraction");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    return missing(c, "fmi3ActivateModelPartition");
}

/* ---- dependencies and derivatives ---- */

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n)
{
    (void)vr, (void)n;
    return missing(c, "fmi3GetNumberOfVariableDependencies");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independents[], size_t independent_elements[],
                                       fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent, (void)elements, (void)independents, (void)independent_elements, (void)kinds, (void)n;
    return missing(c, "fmi3GetVariableDependencies");
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n,
                                        const fmi3ValueReference knowns[], size_t m, const fmi3Float64 seed[],
                                        size_t seeds, fmi3Float64 out[], size_t outs)
{
    if (seeds != m || outs != n) return status(refuse(c, "each variable has one value: give as many seeds and slopes"));
    return status(slopes(c, unknowns, n, knowns, m, seed, out));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n,
                                    const fmi3ValueReference knowns[], size_t m, const fmi3Float64 seed[], size_t seeds,
                                    fmi3Float64 out[], size_t outs)
{
    (void)unknowns, (void)n, (void)knowns, (void)m, (void)seed, (void)seeds, (void)out, (void)outs;
    return missing(c, "fmi3GetAdjointDerivative");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[],
                                    fmi3Float64 value[], size_t m)
{
    (void)vr, (void)orders, (void)value, (void)m;
    return n == 0 ? fmi3OK : missing(c, "fmi3GetOutputDerivatives");
}

/* ---- saved states ---- */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *saved) { return status(save(c, saved)); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState saved) { return status(restore(c, saved)); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *saved)
{
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState saved, size_t *size)
{
    (void)c, (void)saved;
    *size = SERIALIZED;
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState saved, fmi3Byte bytes[], size_t size)
{
    return status(serialize(c, saved, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *saved)
{
    return status(deserialize(c, bytes, size, saved));
}

/* ---- co-simulation ---- */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 from, fmi3Float64 span, fmi3Boolean keeps, fmi3Boolean *event,
                      fmi3Boolean *end_now, fmi3Boolean *early, fmi3Float64 *reached)
{
    (void)keeps;
    int good = communicate(c, from, span);
    *event = *end_now = *early = fmi3False;
    *reached = ((const Instance *)c)->state.now;
    return status(good);
}

fmi3Status fmi3EnterStepMode(fmi3Instance c) { return missing(c, "fmi3EnterStepMode"); }

/* ---- model exchange ---- */

fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    return status(change_mode(c, CONTINUOUS, EVENTS, "fmi3EnterEventMode"));
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c)
{
    return status(change_mode(c, EVENTS, CONTINUOUS, "fmi3EnterContinuousTimeMode"));
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c)
{
    (void)c;
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end_now, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *timed, fmi3Float64 *next)
{
    int planned;
    int good = update(c, &planned, next);
    *again = *end_now = *nominals = fmi3False;
    *values = fmi3True;
    *timed = planned != 0;
    return status(good);
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean keeps, fmi3Boolean *event, fmi3Boolean *end_now)
{
    (void)keeps;
    *event = step_completed(c) != 0;
    *end_now = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return status(set_time(c, time)); }

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n)
{
    return status(set_continuous(c, x, n));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 values[], size_t n)
{
    return status(get_listed(c, derivative, CONTINUOUS_STATES, values, n));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 values[], size_t n)
{
    return status(get_listed(c, indicator, INDICATORS, values, n));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 values[], size_t n)
{
    return status(get_listed(c, continuous, CONTINUOUS_STATES, values, n));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 values[], size_t n)
{
    return status(get_nominals(c, values, n));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    (void)c;
    *n = INDICATORS;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    (void)c;
    *n = CONTINUOUS_STATES;
    return fmi3OK;
}

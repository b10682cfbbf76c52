/* FMI 2.0 over one instance. */
#include "fmi2Functions.h"
#include "instance.h"

/* The logger takes a format. The sentence becomes one that holds no conversion, so that it is right for importers that
 * print formats and readable in those that show them as they are: "%s" alone would tell these nothing. */
static void tell(const Instance *me, const char *sentence)
{
    char format[1024];
    size_t n = 0;
    for (; *sentence != '\0' && n + 2 < sizeof format; ++sentence) {
        if (*sentence == '%') format[n++] = '%';
        format[n++] = *sentence;
    }
    format[n] = '\0';
    if (me->logger != NULL)
        ((fmi2CallbackLogger)me->logger)(me->environment, me->name, fmi2Error, "logStatusError", format);
}

static fmi2Status status(int good) { return good ? fmi2OK : fmi2Error; }

static fmi2Status missing(fmi2Component c, const char *what)
{
    return status(refuse(c, "%s is not offered by this FMU", what));
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

/* ---- life ---- */

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)visible, (void)logging;
    return make(name, guid, resources, type == fmi2ModelExchange, functions == NULL ? NULL : functions->componentEnvironment,
                functions == NULL ? NULL : (void (*)(void))functions->logger);
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    return status(begin_at(c, start));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return status(change_mode(c, MADE, INITIALIZING, "fmi2EnterInitializationMode"));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return status(start(c)); }

fmi2Status fmi2Terminate(fmi2Component c)
{
    return status(end(c));
}

fmi2Status fmi2Reset(fmi2Component c)
{
    restart(c);
    return fmi2OK;
}

/* ---- values ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    int good = 1;
    for (size_t i = 0; i < n; ++i) good = get_value(c, vr[i], &value[i]) && good;
    return status(good);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    int good = 1;
    for (size_t i = 0; i < n; ++i) good = set_value(c, vr[i], value[i]) && good;
    return status(good);
}

#define NO_VARIABLES(function, type)                                                                                  \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[])                        \
    {                                                                                                                  \
        (void)vr, (void)value;                                                                                         \
        return n == 0 ? fmi2OK : missing(c, #function);                                                                \
    }
NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

/* ---- saved states ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) { return status(save(c, saved)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) { return status(restore(c, saved)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    (void)c, (void)saved;
    *size = SERIALIZED;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    return status(serialize(c, saved, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    return status(deserialize(c, bytes, size, saved));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n,
                                        const fmi2ValueReference knowns[], size_t m, const fmi2Real seed[],
                                        fmi2Real out[])
{
    return status(slopes(c, unknowns, n, knowns, m, seed, out));
}

/* ---- co-simulation ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real from, fmi2Real span, fmi2Boolean keeps)
{
    (void)keeps;
    return status(communicate(c, from, span));
}

fmi2Status fmi2CancelStep(fmi2Component c) { return missing(c, "fmi2CancelStep"); }

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)order, (void)value;
    return n == 0 ? fmi2OK : missing(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)order, (void)value;
    return n == 0 ? fmi2OK : missing(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((const Instance *)c)->state.now;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

#define NEVER_PENDING(function, type)                                                                                 \
    fmi2Status function(fmi2Component c, const fmi2StatusKind kind, type *value)                                       \
    {                                                                                                                  \
        (void)c, (void)kind, (void)value;                                                                              \
        return fmi2Discard;                                                                                            \
    }
NEVER_PENDING(fmi2GetStatus, fmi2Status)
NEVER_PENDING(fmi2GetIntegerStatus, fmi2Integer)
NEVER_PENDING(fmi2GetStringStatus, fmi2String)

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    return status(change_mode(c, CONTINUOUS, EVENTS, "fmi2EnterEventMode"));
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return status(change_mode(c, EVENTS, CONTINUOUS, "fmi2EnterContinuousTimeMode"));
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    int timed;
    double next;
    int good = update(c, &timed, &next);
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = fmi2True;
    info->nextEventTimeDefined = timed ? fmi2True : fmi2False;
    info->nextEventTime = next;
    return status(good);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean keeps, fmi2Boolean *event, fmi2Boolean *end_now)
{
    (void)keeps;
    *event = step_completed(c) ? fmi2True : fmi2False;
    *end_now = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return status(set_time(c, time)); }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    return status(set_continuous(c, x, n));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real values[], size_t n)
{
    return status(get_listed(c, derivative, CONTINUOUS_STATES, values, n));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real values[], size_t n)
{
    return status(get_listed(c, indicator, INDICATORS, values, n));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real values[], size_t n)
{
    return status(get_listed(c, continuous, CONTINUOUS_STATES, values, n));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real values[], size_t n)
{
    return status(get_nominals(c, values, n));
}

/* The calls of an importer under one name for FMI 2 and FMI 3, with the exported sources below them. */
#ifndef CALLS_H
#define CALLS_H

#if FMI == 2
#include "fmi2.c"
typedef fmi2Component Axis;
static void hear(void *e, fmi2String name, fmi2Status s, fmi2String category, fmi2String message, ...)
{
    (void)e, (void)name, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}
static const fmi2CallbackFunctions callbacks = {hear, calloc, free, NULL, NULL};
#define NEW(token, resources) fmi2Instantiate("axis", fmi2CoSimulation, token, resources, &callbacks, 0, 1)
#define BEGIN(a, t) (fmi2SetupExperiment(a, 0, 0, t, 0, 0) == fmi2OK ? fmi2EnterInitializationMode(a) : fmi2Error)
#define READY fmi2ExitInitializationMode
#define SET(a, r, v) fmi2SetReal(a, &(fmi2ValueReference){r}, 1, &(double){v})
#define GET(a, r, v) fmi2GetReal(a, &(fmi2ValueReference){r}, 1, v)
#define SLOPE(a, of, by, to) fmi2GetDirectionalDerivative(a, &(unsigned){of}, 1, &(unsigned){by}, 1, &(double){1.0}, to)
#define STEP(a, t, h) fmi2DoStep(a, t, h, 1)
#define SAVE fmi2GetFMUstate
#define RESTORE fmi2SetFMUstate
#define FORGET fmi2FreeFMUstate
#define SIZE fmi2SerializedFMUstateSize
#define PACK(a, s, b, n) fmi2SerializeFMUstate(a, s, (fmi2Byte *)(b), n)
#define UNPACK(a, b, n, s) fmi2DeSerializeFMUstate(a, (const fmi2Byte *)(b), n, s)
#define RESET fmi2Reset
#define END fmi2Terminate
#define FREE fmi2FreeInstance
#define NEW_EXCHANGE(token, resources) fmi2Instantiate("axis", fmi2ModelExchange, token, resources, &callbacks, 0, 1)
#define UPDATE(a) fmi2NewDiscreteStates(a, &(fmi2EventInfo){0})
#define TO_EVENTS fmi2EnterEventMode
#define TO_CONTINUOUS fmi2EnterContinuousTimeMode
#define SET_TIME fmi2SetTime
#define SET_STATES fmi2SetContinuousStates
#define GET_STATES fmi2GetContinuousStates
#define RATES fmi2GetDerivatives
#define MARGINS fmi2GetEventIndicators
#define NOMINALS fmi2GetNominalsOfContinuousStates
#else
#include "fmi3.c"
typedef fmi3Instance Axis;
static void hear(void *e, fmi3Status s, fmi3String category, fmi3String message)
{
    (void)e, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}
#define NEW(token, resources)                                                                                          \
    fmi3InstantiateCoSimulation("axis", token, resources, 0, 1, 0, 0, NULL, 0, NULL, hear, NULL)
#define BEGIN(a, t) fmi3EnterInitializationMode(a, 0, 0, t, 0, 0)
#define READY fmi3ExitInitializationMode
#define SET(a, r, v) fmi3SetFloat64(a, &(fmi3ValueReference){r}, 1, &(double){v}, 1)
#define GET(a, r, v) fmi3GetFloat64(a, &(fmi3ValueReference){r}, 1, v, 1)
#define SLOPE(a, of, by, to) \
    fmi3GetDirectionalDerivative(a, &(unsigned){of}, 1, &(unsigned){by}, 1, &(double){1.0}, 1, to, 1)
#define STEP(a, t, h) fmi3DoStep(a, t, h, 1, FLAG, FLAG, FLAG, &(double){0})
#define SAVE fmi3GetFMUState
#define RESTORE fmi3SetFMUState
#define FORGET fmi3FreeFMUState
#define SIZE fmi3SerializedFMUStateSize
#define PACK fmi3SerializeFMUState
#define UNPACK fmi3DeserializeFMUState
#define RESET fmi3Reset
#define END fmi3Terminate
#define FREE fmi3FreeInstance
#define NEW_EXCHANGE(token, resources) fmi3InstantiateModelExchange("axis", token, resources, 0, 1, NULL, hear)
#define FLAG (&(fmi3Boolean){0})
#define UPDATE(a) fmi3UpdateDiscreteStates(a, FLAG, FLAG, FLAG, FLAG, FLAG, &(double){0})
#define TO_EVENTS fmi3EnterEventMode
#define TO_CONTINUOUS fmi3EnterContinuousTimeMode
#define SET_TIME fmi3SetTime
#define SET_STATES fmi3SetContinuousStates
#define GET_STATES fmi3GetContinuousStates
#define RATES fmi3GetContinuousStateDerivatives
#define MARGINS fmi3GetEventIndicators
#define NOMINALS fmi3GetNominalsOfContinuousStates
#endif

#endif

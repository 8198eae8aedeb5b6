/* The co-simulation interface of FMI 3.0 to a slave. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define FMI __declspec(dllexport)
#else
#define FMI __attribute__((visibility("default")))
#endif

typedef void *fmi3Instance, *fmi3FMUState, *fmi3Environment;
typedef uint32_t fmi3ValueReference;
typedef const char *fmi3String;
typedef const uint8_t *fmi3Binary;
typedef int fmi3Status, fmi3Kind;
enum { OK, WARNING, DISCARD, ERROR };
typedef void (*fmi3LogMessage)(fmi3Environment, fmi3Status, fmi3String category, fmi3String message);
typedef void (*fmi3IntermediateUpdate)(fmi3Environment, double, bool, bool, bool, bool, bool *, double *);
typedef struct {
    fmi3LogMessage log;
    fmi3Environment environment;
} host_of_slave;

#include "$slave"

static int refuse(const slave *s, const char *message)
{
    if (s->host.log) {
        s->host.log(s->host.environment, ERROR, "logStatusError", message);
    }
    return ERROR;
}

#define ENTRY(name, parameters, otherwise, arguments)                                                                    \
    FMI fmi3Status name parameters { BODY(name, parameters, otherwise, arguments) }
#define REFUSED(name, parameters)                                                                                        \
    FMI fmi3Status name parameters { return refuse(c, #name ": not available"); }

/* Life cycle */

FMI const char *fmi3GetVersion(void) { return "3.0"; }
ENTRY(fmi3SetDebugLogging, (fmi3Instance c, bool on, size_t n, const fmi3String categories[]), OK,
      (INNER(c), on, n, categories))

FMI fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, bool visible, bool logging, bool event_mode, bool early_return,
    const fmi3ValueReference intermediate[], size_t n, fmi3Environment environment, fmi3LogMessage log,
    fmi3IntermediateUpdate update)
{
    slave *s = calloc(1, sizeof *s);
    if (!s) {
        return NULL;
    }
    s->host = (host_of_slave){log, environment};
    snprintf(s->name, sizeof s->name, "%s", name ? name : "");
    const char *fault = !token || strcmp(token, "$guid") != 0
                            ? "the instantiation token is not $guid: binary and modelDescription.xml differ"
                            : NULL;
    if (fault ? refuse(s, fault) : begin(s, resources, logging)) {
        free(s);
        return NULL;
    }
    return s;
}
FMI fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String resources, bool visible, bool logging, fmi3Environment environment,
    fmi3LogMessage log)
{
    return NULL;
}
FMI fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, bool visible, bool logging, fmi3Environment environment,
    fmi3LogMessage log, void (*clock)(fmi3Environment), void (*lock)(void), void (*unlock)(void))
{
    return NULL;
}

FMI void fmi3FreeInstance(fmi3Instance c)
{
    if (c) {
        end(c);
    }
    free(c);
}
FMI fmi3Status fmi3EnterInitializationMode(
    fmi3Instance c, bool with_tolerance, double tolerance, double start, bool with_stop, double stop)
{
    ((slave *)c)->time = start;
    BODY(fmi3EnterInitializationMode, (fmi3Instance, bool, double, double, bool, double), OK,
         (INNER(c), with_tolerance, tolerance, start, with_stop, stop))
}
FMI fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    const int status = enter(c);
    if (status > WARNING) {
        return status;
    }
    BODY(fmi3ExitInitializationMode, (fmi3Instance), OK, (INNER(c)))
}
ENTRY(fmi3EnterConfigurationMode, (fmi3Instance c), OK, (INNER(c)))
ENTRY(fmi3ExitConfigurationMode, (fmi3Instance c), OK, (INNER(c)))
ENTRY(fmi3Terminate, (fmi3Instance c), OK, (INNER(c)))
FMI fmi3Status fmi3Reset(fmi3Instance c) { return reset(c); }

/* Values */

FMI fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference which[], size_t n, double values[], size_t count)
{
    if (n != count) {
        BODY(fmi3GetFloat64, (fmi3Instance, const fmi3ValueReference[], size_t, double[], size_t),
             refuse(c, "fmi3GetFloat64: all variables are scalars"), (INNER(c), which, n, values, count))
    }
    int worst = OK;
    for (size_t i = 0; i < n && worst <= WARNING; i++) {
        const int status = get(c, which[i], values + i);
        worst = status > worst ? status : worst;
    }
    return worst;
}

FMI fmi3Status fmi3SetFloat64(
    fmi3Instance c, const fmi3ValueReference which[], size_t n, const double values[], size_t count)
{
    if (n != count) {
        BODY(fmi3SetFloat64, (fmi3Instance, const fmi3ValueReference[], size_t, const double[], size_t),
             refuse(c, "fmi3SetFloat64: all variables are scalars"), (INNER(c), which, n, values, count))
    }
    int worst = OK;
    for (size_t i = 0; i < n && worst <= WARNING; i++) {
        const int status = set(c, which[i], values[i]);
        worst = status > worst ? status : worst;
    }
    return worst;
}

#define VALUES(kind, type)                                                                                               \
    ENTRY(fmi3Get##kind,                                                                                                 \
          (fmi3Instance c, const fmi3ValueReference which[], size_t n, type values[], size_t count),                     \
          n ? refuse(c, "fmi3Get" #kind ": all variables are Float64") : OK, (INNER(c), which, n, values, count))        \
    ENTRY(fmi3Set##kind,                                                                                                 \
          (fmi3Instance c, const fmi3ValueReference which[], size_t n, const type values[], size_t count),               \
          n ? refuse(c, "fmi3Set" #kind ": all variables are Float64") : OK, (INNER(c), which, n, values, count))
VALUES(Float32, float)
VALUES(Int8, int8_t)
VALUES(UInt8, uint8_t)
VALUES(Int16, int16_t)
VALUES(UInt16, uint16_t)
VALUES(Int32, int32_t)
VALUES(UInt32, uint32_t)
VALUES(Int64, int64_t)
VALUES(UInt64, uint64_t)
VALUES(Boolean, bool)
VALUES(String, fmi3String)
ENTRY(fmi3GetBinary,
      (fmi3Instance c, const fmi3ValueReference which[], size_t n, size_t sizes[], fmi3Binary values[], size_t count),
      n ? refuse(c, "fmi3GetBinary: all variables are Float64") : OK, (INNER(c), which, n, sizes, values, count))
ENTRY(fmi3SetBinary,
      (fmi3Instance c, const fmi3ValueReference which[], size_t n, const size_t sizes[], const fmi3Binary values[],
       size_t count),
      n ? refuse(c, "fmi3SetBinary: all variables are Float64") : OK, (INNER(c), which, n, sizes, values, count))
ENTRY(fmi3GetClock, (fmi3Instance c, const fmi3ValueReference which[], size_t n, bool values[]),
      n ? refuse(c, "fmi3GetClock: all variables are Float64") : OK, (INNER(c), which, n, values))
ENTRY(fmi3SetClock, (fmi3Instance c, const fmi3ValueReference which[], size_t n, const bool values[]),
      n ? refuse(c, "fmi3SetClock: all variables are Float64") : OK, (INNER(c), which, n, values))

/* Steps */

FMI fmi3Status fmi3DoStep(
    fmi3Instance c, double time, double step, bool no_going_back, bool *event, bool *terminate, bool *early, double *reached)
{
    slave *s = c;
    if (!(step >= 0.0) || !isfinite(step)) {
        return refuse(s, "fmi3DoStep: the step is negative or not finite");
    }
    const int status = step_to(s, time, step);
    s->time = status > WARNING ? time : time + step;
    *event = *early = false;
    *terminate = s->terminate;
    *reached = s->time;
    return status;
}

/* States */

FMI fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    slave *s = c, *copy = *state ? *state : calloc(1, sizeof *s);
    if (!copy) {
        return refuse(s, "fmi3GetFMUState: out of memory");
    }
    void *of_inner = copy->kept;
    *copy = *s;
    copy->kept = of_inner;
    *state = copy;
    return keep(s, &copy->kept);
}
FMI fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    slave *s = c, *copy = state;
    *s = *copy;
    s->kept = NULL;
    return restore(s, copy->kept);
}
FMI fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    const int status = *state ? forget(c, &((slave *)*state)->kept) : OK;
    free(*state);
    *state = NULL;
    return status;
}

/* Functions of the standard that this slave does not provide */

REFUSED(fmi3SerializedFMUStateSize, (fmi3Instance c, fmi3FMUState state, size_t *size))
REFUSED(fmi3SerializeFMUState, (fmi3Instance c, fmi3FMUState state, uint8_t bytes[], size_t size))
REFUSED(fmi3DeserializeFMUState, (fmi3Instance c, const uint8_t bytes[], size_t size, fmi3FMUState *state))
REFUSED(fmi3GetDirectionalDerivative,
        (fmi3Instance c, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t m,
         const double seed[], size_t seeds, double result[], size_t results))
REFUSED(fmi3GetAdjointDerivative,
        (fmi3Instance c, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t m,
         const double seed[], size_t seeds, double result[], size_t results))
REFUSED(fmi3GetOutputDerivatives,
        (fmi3Instance c, const fmi3ValueReference which[], size_t n, const int32_t orders[], double values[], size_t count))
REFUSED(fmi3GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference which, size_t *n))
REFUSED(fmi3GetVariableDependencies,
        (fmi3Instance c, fmi3ValueReference dependent, size_t elements[], fmi3ValueReference independents[],
         size_t elements_of_these[], fmi3Kind kinds[], size_t n))
REFUSED(fmi3EnterEventMode, (fmi3Instance c))
REFUSED(fmi3EnterStepMode, (fmi3Instance c))
REFUSED(fmi3EvaluateDiscreteStates, (fmi3Instance c))
REFUSED(fmi3UpdateDiscreteStates,
        (fmi3Instance c, bool *update, bool *terminate, bool *nominals, bool *states, bool *defined, double *next))
REFUSED(fmi3GetIntervalDecimal,
        (fmi3Instance c, const fmi3ValueReference which[], size_t n, double intervals[], fmi3Kind kinds[]))
REFUSED(fmi3GetIntervalFraction,
        (fmi3Instance c, const fmi3ValueReference which[], size_t n, uint64_t counters[], uint64_t resolutions[],
         fmi3Kind kinds[]))
REFUSED(fmi3GetShiftDecimal, (fmi3Instance c, const fmi3ValueReference which[], size_t n, double shifts[]))
REFUSED(fmi3GetShiftFraction,
        (fmi3Instance c, const fmi3ValueReference which[], size_t n, uint64_t counters[], uint64_t resolutions[]))
REFUSED(fmi3SetIntervalDecimal, (fmi3Instance c, const fmi3ValueReference which[], size_t n, const double intervals[]))
REFUSED(fmi3SetIntervalFraction,
        (fmi3Instance c, const fmi3ValueReference which[], size_t n, const uint64_t counters[], const uint64_t resolutions[]))
REFUSED(fmi3SetShiftDecimal, (fmi3Instance c, const fmi3ValueReference which[], size_t n, const double shifts[]))
REFUSED(fmi3SetShiftFraction,
        (fmi3Instance c, const fmi3ValueReference which[], size_t n, const uint64_t counters[], const uint64_t resolutions[]))
REFUSED(fmi3ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, double time))
/* Of model exchange, which some importers look up in every FMU */
REFUSED(fmi3EnterContinuousTimeMode, (fmi3Instance c))
REFUSED(fmi3CompletedIntegratorStep, (fmi3Instance c, bool no_going_back, bool *event, bool *terminate))
REFUSED(fmi3SetTime, (fmi3Instance c, double time))
REFUSED(fmi3SetContinuousStates, (fmi3Instance c, const double states[], size_t n))
REFUSED(fmi3GetContinuousStateDerivatives, (fmi3Instance c, double derivatives[], size_t n))
REFUSED(fmi3GetEventIndicators, (fmi3Instance c, double indicators[], size_t n))
REFUSED(fmi3GetContinuousStates, (fmi3Instance c, double states[], size_t n))
REFUSED(fmi3GetNominalsOfContinuousStates, (fmi3Instance c, double nominals[], size_t n))
REFUSED(fmi3GetNumberOfEventIndicators, (fmi3Instance c, size_t *n))
REFUSED(fmi3GetNumberOfContinuousStates, (fmi3Instance c, size_t *n))

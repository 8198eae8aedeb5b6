/* The co-simulation interface of FMI 2.0 to a slave. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define FMI __declspec(dllexport)
#else
#define FMI __attribute__((visibility("default")))
#endif

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef int fmi2Status;
enum { OK, WARNING, DISCARD, ERROR };
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String instance, fmi2Status, fmi2String category, fmi2String message, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment environment;
} fmi2CallbackFunctions;
typedef const fmi2CallbackFunctions *host_of_slave;

#include "$slave"

static int refuse(const slave *s, const char *message)
{
    if (s->host && s->host->logger) {
        s->host->logger(s->host->environment, s->name, ERROR, "logStatusError", "%s", message);
    }
    return ERROR;
}

#define ENTRY(name, parameters, otherwise, arguments)                                                                    \
    FMI fmi2Status name parameters { BODY(name, parameters, otherwise, arguments) }

/* Life cycle */

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }
ENTRY(fmi2SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]), OK,
      (INNER(c), on, n, categories))

FMI fmi2Component fmi2Instantiate(
    fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *functions,
    fmi2Boolean visible, fmi2Boolean logging)
{
    slave *s = calloc(1, sizeof *s);
    if (!s) {
        return NULL;
    }
    s->host = functions;
    snprintf(s->name, sizeof s->name, "%s", name ? name : "");
    const char *fault = type != fmi2CoSimulation              ? "this FMU is for co-simulation only"
                        : !guid || strcmp(guid, "$guid") != 0 ? "the GUID is not $guid: binary and modelDescription.xml differ"
                                                              : NULL;
    if (fault ? refuse(s, fault) : begin(s, resources, logging)) {
        free(s);
        return NULL;
    }
    return s;
}

FMI void fmi2FreeInstance(fmi2Component c)
{
    if (c) {
        end(c);
    }
    free(c);
}
ENTRY(fmi2SetupExperiment,
      (fmi2Component c, fmi2Boolean with_tolerance, fmi2Real tolerance, fmi2Real start, fmi2Boolean with_stop, fmi2Real stop),
      OK, (INNER(c), with_tolerance, tolerance, start, with_stop, stop))
ENTRY(fmi2EnterInitializationMode, (fmi2Component c), OK, (INNER(c)))
FMI fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    const int status = enter(c);
    if (status > WARNING) {
        return status;
    }
    BODY(fmi2ExitInitializationMode, (fmi2Component), OK, (INNER(c)))
}
ENTRY(fmi2Terminate, (fmi2Component c), OK, (INNER(c)))
FMI fmi2Status fmi2Reset(fmi2Component c) { return reset(c); }

/* Values */

FMI fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference which[], size_t n, fmi2Real values[])
{
    int worst = OK;
    for (size_t i = 0; i < n && worst <= WARNING; i++) {
        const int status = get(c, which[i], values + i);
        worst = status > worst ? status : worst;
    }
    return worst;
}

FMI fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Real values[])
{
    int worst = OK;
    for (size_t i = 0; i < n && worst <= WARNING; i++) {
        const int status = set(c, which[i], values[i]);
        worst = status > worst ? status : worst;
    }
    return worst;
}

#define VALUES(name, type)                                                                                               \
    ENTRY(name, (fmi2Component c, const fmi2ValueReference which[], size_t n, type values[]),                            \
          n ? refuse(c, #name ": all variables are real") : OK, (INNER(c), which, n, values))
VALUES(fmi2GetInteger, fmi2Integer)
VALUES(fmi2GetBoolean, fmi2Boolean)
VALUES(fmi2GetString, fmi2String)
VALUES(fmi2SetInteger, const fmi2Integer)
VALUES(fmi2SetBoolean, const fmi2Boolean)
VALUES(fmi2SetString, const fmi2String)

/* Steps */

FMI fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean final)
{
    if (!(step >= 0.0) || !isfinite(step)) {
        return refuse(c, "fmi2DoStep: the step is negative or not finite");
    }
    return step_to(c, time, step);
}
ENTRY(fmi2CancelStep, (fmi2Component c), refuse(c, "fmi2CancelStep: steps are never pending"), (INNER(c)))

#define GET_STATUS(name, type)                                                                                           \
    ENTRY(name, (fmi2Component c, const fmi2StatusKind kind, type *value), DISCARD, (INNER(c), kind, value))
GET_STATUS(fmi2GetStatus, fmi2Status)
GET_STATUS(fmi2GetRealStatus, fmi2Real)
GET_STATUS(fmi2GetIntegerStatus, fmi2Integer)
GET_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
GET_STATUS(fmi2GetStringStatus, fmi2String)

/* States */

FMI fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    slave *s = c, *copy = *state ? *state : calloc(1, sizeof *s);
    if (!copy) {
        return refuse(s, "fmi2GetFMUstate: out of memory");
    }
    void *of_inner = copy->kept;
    *copy = *s;
    copy->kept = of_inner;
    *state = copy;
    return keep(s, &copy->kept);
}
FMI fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    slave *s = c, *copy = state;
    *s = *copy;
    s->kept = NULL;
    return restore(s, copy->kept);
}
FMI fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    const int status = *state ? forget(c, &((slave *)*state)->kept) : OK;
    free(*state);
    *state = NULL;
    return status;
}

/* Functions of the standard that this slave does not provide */

#define REFUSED(name, parameters)                                                                                        \
    FMI fmi2Status name parameters { return refuse(c, #name ": not available"); }
REFUSED(fmi2SerializedFMUstateSize, (fmi2Component c, fmi2FMUstate state, size_t *size))
REFUSED(fmi2SerializeFMUstate, (fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size))
REFUSED(fmi2DeSerializeFMUstate, (fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state))
REFUSED(fmi2GetDirectionalDerivative,
        (fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns, const fmi2ValueReference known[],
         size_t knowns, const fmi2Real seed[], fmi2Real result[]))
REFUSED(fmi2SetRealInputDerivatives,
        (fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Integer order[], const fmi2Real values[]))
REFUSED(fmi2GetRealOutputDerivatives,
        (fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Integer order[], fmi2Real values[]))

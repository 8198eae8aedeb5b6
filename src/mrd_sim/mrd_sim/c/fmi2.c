/*
 * A damper as a co-simulation slave of the Functional Mock-up Interface 2.0.
 *
 * Value references: the damper's parameters in their order, then position, velocity, acceleration, current, then force.
 *
 * The force depends on the inputs at the same communication point. Until they are set there, the motion is extrapolated from
 * the point before by velocity and acceleration. The extrapolation does not enter the state once the inputs are set.
 */
#include "damper.c"
#include <stdio.h>
#include <stdlib.h>

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
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String instance, fmi2Status, fmi2String category, fmi2String message, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment environment;
} fmi2CallbackFunctions;

enum { POSITION, VELOCITY, ACCELERATION, CURRENT, ${simulator}INPUTS };
enum { FIRST_INPUT = MRD_PARAMETERS, FORCE = MRD_PARAMETERS + INPUTS };

typedef struct {
    mrd_state damper;     /* at the communication point before */
    mrd_state here;       /* at the present one, if the force is known */
    double force;         /* at the present one */
    int known;            /* whether the force is known: no input or parameter was set since */
    double input[INPUTS]; /* as last set */
    double now[INPUTS];   /* at the present communication point */
    double elapsed;       /* s since the communication point before */
    const fmi2CallbackFunctions *host;
    char name[128];
} slave;

static fmi2Status refuse(const slave *s, const char *message)
{
    if (s->host && s->host->logger) {
        s->host->logger(s->host->environment, s->name, fmi2Error, "logStatusError", "%s", message);
    }
    return fmi2Error;
}

static void rest(slave *s)
{
    mrd_init(&s->damper);
    memset(s->input, 0, sizeof s->input);
    memset(s->now, 0, sizeof s->now);
    s->elapsed = 0.0;
    s->known = 0;
}

static void pass(slave *s)
{
    if (!s->known) {
        s->here = s->damper;
        s->force = mrd_step(
            &s->here, s->elapsed, s->now[POSITION], s->now[VELOCITY], s->now[ACCELERATION], s->now[CURRENT]$simulator_now);
        s->known = 1;
    }
}

/* Life cycle of a slave */

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    return fmi2OK;
}

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
    if (type != fmi2CoSimulation || !guid || strcmp(guid, "$guid") != 0) {
        refuse(s, type != fmi2CoSimulation ? "this FMU is for co-simulation only"
                                           : "the GUID is not $guid: binary and modelDescription.xml differ");
        free(s);
        return NULL;
    }
    rest(s);
    return s;
}

FMI void fmi2FreeInstance(fmi2Component c) { free(c); }
FMI fmi2Status fmi2SetupExperiment(
    fmi2Component c, fmi2Boolean with_tolerance, fmi2Real tolerance, fmi2Real start, fmi2Boolean with_stop, fmi2Real stop)
{
    return fmi2OK;
}
FMI fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
FMI fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
FMI fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
FMI fmi2Status fmi2Reset(fmi2Component c)
{
    rest(c);
    return fmi2OK;
}

/* Values */

FMI fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference which[], size_t n, fmi2Real values[])
{
    slave *s = c;
    for (size_t i = 0; i < n; i++) {
        if (which[i] < FIRST_INPUT) {
            values[i] = s->damper.parameters[which[i]];
        } else if (which[i] < FORCE) {
            values[i] = s->input[which[i] - FIRST_INPUT];
        } else if (which[i] == FORCE) {
            pass(s);
            values[i] = s->force;
        } else {
            return refuse(s, "fmi2GetReal: unknown value reference");
        }
    }
    return fmi2OK;
}

FMI fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Real values[])
{
    slave *s = c;
    char message[256];
    s->known = 0;
    for (size_t i = 0; i < n; i++) {
        if (which[i] < FIRST_INPUT) {
            const mrd_parameter *p = &mrd_parameters[which[i]];
            if (!(p->lower <= values[i] && values[i] <= p->upper)) {
                snprintf(message, sizeof message, "%s is %g, expected %.3g to %.3g %s", p->name, values[i], p->lower, p->upper,
                         p->unit);
                return refuse(s, message);
            }
            s->damper.parameters[which[i]] = values[i];
        } else if (which[i] < FORCE) {
            if (!isfinite(values[i])) {
                return refuse(s, "an input is not finite");
            }
            s->input[which[i] - FIRST_INPUT] = s->now[which[i] - FIRST_INPUT] = values[i];
        } else {
            return refuse(s, "fmi2SetReal: the value reference belongs to no parameter or input");
        }
    }
    return fmi2OK;
}

FMI fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean final)
{
    slave *s = c;
    if (!(step >= 0.0) || !isfinite(step)) {
        return refuse(s, "fmi2DoStep: the step is negative or not finite");
    }
    if (step > 0.0) {
        pass(s);
        s->damper = s->here;
        s->known = 0;
        s->elapsed = step;
        s->now[POSITION] += step * (s->now[VELOCITY] + 0.5 * step * s->now[ACCELERATION]);
        s->now[VELOCITY] += step * s->now[ACCELERATION];
    }
    return fmi2OK;
}

FMI fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state) {
        *state = malloc(sizeof(slave));
    }
    if (!*state) {
        return refuse(c, "fmi2GetFMUstate: out of memory");
    }
    memcpy(*state, c, sizeof(slave));
    return fmi2OK;
}
FMI fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(slave));
    return fmi2OK;
}
FMI fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* Functions of the standard that this slave does not provide */

#define NO_VALUES(name, type)                                                                                            \
    FMI fmi2Status name(fmi2Component c, const fmi2ValueReference which[], size_t n, type values[])                      \
    {                                                                                                                    \
        return n ? refuse(c, #name ": all variables are real") : fmi2OK;                                                 \
    }
NO_VALUES(fmi2GetInteger, fmi2Integer)
NO_VALUES(fmi2GetBoolean, fmi2Boolean)
NO_VALUES(fmi2GetString, fmi2String)
NO_VALUES(fmi2SetInteger, const fmi2Integer)
NO_VALUES(fmi2SetBoolean, const fmi2Boolean)
NO_VALUES(fmi2SetString, const fmi2String)

#define NO_STATUS(name, type)                                                                                            \
    FMI fmi2Status name(fmi2Component c, const fmi2StatusKind kind, type *value) { return fmi2Discard; }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetRealStatus, fmi2Real)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_STATUS(fmi2GetStringStatus, fmi2String)

FMI fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, "fmi2CancelStep: steps are never pending"); }
FMI fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    return refuse(c, "fmi2SerializedFMUstateSize: not available");
}
FMI fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return refuse(c, "fmi2SerializeFMUstate: not available");
}
FMI fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return refuse(c, "fmi2DeSerializeFMUstate: not available");
}
FMI fmi2Status fmi2GetDirectionalDerivative(
    fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns, const fmi2ValueReference known[], size_t knowns,
    const fmi2Real seed[], fmi2Real result[])
{
    return refuse(c, "fmi2GetDirectionalDerivative: not available");
}
FMI fmi2Status fmi2SetRealInputDerivatives(
    fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Integer order[], const fmi2Real values[])
{
    return refuse(c, "fmi2SetRealInputDerivatives: not available");
}
FMI fmi2Status fmi2GetRealOutputDerivatives(
    fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Integer order[], fmi2Real values[])
{
    return refuse(c, "fmi2GetRealOutputDerivatives: not available");
}

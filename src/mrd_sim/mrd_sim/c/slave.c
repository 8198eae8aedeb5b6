/*
 * A damper as a co-simulation slave, whatever the version of the interface.
 *
 * Value references: the damper's parameters in their order, then position, velocity, acceleration, current, then force.
 *
 * The force depends on the inputs at the same communication point. Until they are set there, the motion is extrapolated from
 * the point before by velocity and acceleration. The extrapolation does not enter the state once the inputs are set.
 */
#include "damper.c"

enum { POSITION, VELOCITY, ACCELERATION, CURRENT, ${simulator}INPUTS };
enum { FIRST_INPUT = MRD_PARAMETERS, FORCE = MRD_PARAMETERS + INPUTS, TIME };

typedef struct {
    mrd_state damper;     /* at the communication point before */
    mrd_state here;       /* at the present one, if the force is known */
    double force;         /* at the present one */
    int known;            /* whether the force is known: no input or parameter was set since */
    double input[INPUTS]; /* as last set */
    double now[INPUTS];   /* at the present communication point */
    double elapsed;       /* s since the communication point before */
    double time;          /* s */
    int terminate;        /* never asked for */
    void *kept;           /* nothing */
    host_of_slave host;
    char name[128];
} slave;

static int refuse(const slave *s, const char *message);
#include "parameter.c"

/* Functions of the interface for which a damper has nothing to do. */
#define BODY(name, parameters, otherwise, arguments) return otherwise;

static int reset(slave *s)
{
    mrd_init(&s->damper);
    memset(s->input, 0, sizeof s->input);
    memset(s->now, 0, sizeof s->now);
    s->elapsed = 0.0;
    s->known = 0;
    return OK;
}

static int begin(slave *s, const char *resources, int logging) { return reset(s); }
static void end(slave *s) {}
static int enter(slave *s) { return OK; }
static int keep(slave *s, void **state) { return OK; }
static int restore(slave *s, void *state) { return OK; }
static int forget(slave *s, void **state) { return OK; }

static void pass(slave *s)
{
    if (!s->known) {
        s->here = s->damper;
        s->force = mrd_step(
            &s->here, s->elapsed, s->now[POSITION], s->now[VELOCITY], s->now[ACCELERATION], s->now[CURRENT]$simulator_now);
        s->known = 1;
    }
}

static int get(slave *s, unsigned which, double *value)
{
    if (which < FIRST_INPUT) {
        *value = s->damper.parameters[which];
    } else if (which < FORCE) {
        *value = s->input[which - FIRST_INPUT];
    } else if (which == FORCE) {
        pass(s);
        *value = s->force;
    } else if (which == TIME) {
        *value = s->time;
    } else {
        return refuse(s, "the value that is asked for is unknown");
    }
    return OK;
}

static int set(slave *s, unsigned which, double value)
{
    s->known = 0;
    if (which < FIRST_INPUT) {
        return set_parameter(s, &s->damper, which, value);
    }
    if (which >= FORCE) {
        return refuse(s, "the value that is set belongs to no parameter or input");
    }
    if (!isfinite(value)) {
        return refuse(s, "an input is not finite");
    }
    s->input[which - FIRST_INPUT] = s->now[which - FIRST_INPUT] = value;
    return OK;
}

static int step_to(slave *s, double time, double step)
{
    if (step > 0.0) {
        pass(s);
        s->damper = s->here;
        s->known = 0;
        s->elapsed = step;
        s->now[POSITION] += step * (s->now[VELOCITY] + 0.5 * step * s->now[ACCELERATION]);
        s->now[VELOCITY] += step * s->now[ACCELERATION];
    }
    return OK;
}

/*
 * A slave that carries the FMU of a simulator in its resources: the inner one. It has the same variables, and those of the
 * effects. The inner slave answers to the motion and the current that the effects before the damper leave; the effects behind
 * the damper act on its force.
 *
 * Where the inner force follows inputs that are set at the same communication point, so does this one; until they are set, the
 * motion is extrapolated by velocity and acceleration. Where it follows only after a step, this one does, too.
 */
#include "damper.c"

enum { POSITION, VELOCITY, ACCELERATION, CURRENT, QUANTITIES };
enum { FOLLOWS_AT_ONCE = $at_once, IN_SERIES = $in_series };
enum { FIRST_EFFECT = $first_effect, EFFECTS = MRD_PARAMETERS - FIRST_EFFECT };

/* Where a quantity comes from: from an input that the inner slave has, from one of the wrapper's own, from differences. */
enum { OF_INNER, OWN, DERIVED };
static const int origin[QUANTITIES] = {$origins};
static const unsigned references[QUANTITIES] = {$references};
static const double factors[QUANTITIES] = {$factors}; /* from SI to the unit of the input */
static const double starts[QUANTITIES] = {$starts};   /* of the inputs, in SI */
static const unsigned force_reference = $force_reference, first_reference = $first_reference; /* of the effects' parameters */
static const double force_factor = $force_factor; /* from the unit of the output to N */

/* Parameters of the inner slave with other values than its own. */
enum { SETTINGS = $settings };
static const unsigned set_references[] = {$set_references};
static const double set_values[] = {$set_values};

typedef struct {
    mrd_state damper;          /* at the communication point before */
    mrd_state here;            /* at the present one, if the force is known */
    double force;              /* at the present one */
    int known;                 /* whether the force is known */
    double input[QUANTITIES];  /* as last set, in SI */
    double now[QUANTITIES];    /* at the present communication point, in SI */
    double elapsed;            /* s since the communication point before */
    double time;               /* s */
    int terminate;             /* whether the inner slave asks for the end */
    void *kept;                /* state of the inner slave, in a kept state */
    void *inner, *library;
    host_of_slave host;
    char name[128];
} slave;

static int refuse(const slave *s, const char *message);
#include "parameter.c"
#include "library.c"

#define INNER(c) (((slave *)(c))->inner)
/* Call a function of the inner slave, and return its status; s is this slave. */
#define CALL(name, parameters, arguments)                                                                                \
    int (*call) parameters;                                                                                              \
    return find(s, #name, &call) ? call arguments : ERROR;
/* The body of a function of the interface that the inner slave provides; c is this slave. */
#define BODY(name, parameters, otherwise, arguments)                                                                     \
    const slave *const s = c;                                                                                            \
    CALL(name, parameters, arguments)

#include "$inner"

static int rest(slave *s)
{
    mrd_init(&s->damper);
    memcpy(s->input, starts, sizeof s->input);
    memcpy(s->now, starts, sizeof s->now);
    s->elapsed = s->force = 0.0;
    s->known = s->terminate = 0;
    return SETTINGS ? inner_set(s, set_references, SETTINGS, set_values) : OK;
}

static int reset(slave *s)
{
    const int status = inner_reset(s);
    return status > WARNING ? status : rest(s);
}

static int begin(slave *s, const char *resources, int logging)
{
    const int status = inner_begin(s, resources, logging);
    return status > WARNING ? status : rest(s);
}

static void end(slave *s)
{
    inner_end(s);
    close_library(s);
}

/* Set the inputs of the inner slave to the motion and current that the effects leave at the present communication point. */
static int lead_inner(slave *s, mrd_state *here, double elapsed)
{
    double *now = s->now, left[QUANTITIES], values[QUANTITIES];
    unsigned which[QUANTITIES];
    int n = 0;
    const int moved = here->moved && elapsed > 0.0;
    if (origin[VELOCITY] == DERIVED) {
        now[VELOCITY] = moved ? (now[POSITION] - here->position) / elapsed : 0.0;
    }
    if (origin[ACCELERATION] == DERIVED) {
        now[ACCELERATION] = moved ? (now[VELOCITY] - here->velocity) / elapsed : 0.0;
    }
    mrd_motion(here, elapsed, now[POSITION], now[VELOCITY], now[ACCELERATION], now[CURRENT], left);
    for (int i = 0; i < QUANTITIES; i++) {
        if (origin[i] == OF_INNER) {
            which[n] = references[i];
            values[n++] = left[i] * factors[i];
        }
    }
    return inner_set(s, which, n, values);
}

/* Take the force of the inner slave, in its unit, and give it the effects behind the damper. */
static int follow_inner(slave *s, mrd_state *here)
{
    double force;
    const int status = inner_get(s, force_reference, &force);
    if (status <= WARNING && !isfinite(force)) {
        return refuse(s, "the force of the simulator inside is not finite");
    }
    s->force = mrd_force(here, force * force_factor) / force_factor;
    return status;
}

/* Ask the inner slave, where elements in series give way under a guess of its force beyond the model; wrong by what is left. */
static int try_guess(slave *s, double guess, double *left)
{
    s->here = s->damper;
    s->here.guess = guess;
    const int led = lead_inner(s, &s->here, s->elapsed), answered = led > WARNING ? led : follow_inner(s, &s->here);
    *left = s->here.excess - guess;
    return answered > led ? answered : led;
}

/*
 * Find the force at the present communication point. Elements in series give way under a force that falls as they do. So there
 * is one guess that is right, between the first one and its answer; it is found by false position (Illinois method).
 */
static int pass(slave *s)
{
    double guess = s->damper.guess, left, other = 0.0, left_other = 0.0;
    int status = s->known ? OK : try_guess(s, guess, &left);
    for (int i = 0; !s->known && IN_SERIES && status <= WARNING && i < 100; i++) {
        if (fabs(left) <= 1e-8 + 1e-9 * fabs(s->here.excess) || (i > 0 && fabs(other - guess) <= 1e-8)) {
            break;
        }
        const double share = i == 0 ? 0.0 : i % 3 ? left / (left - left_other) : 0.5;
        const double next = i == 0 ? guess + left : guess + share * (other - guess);
        double left_next;
        status = try_guess(s, next, &left_next);
        if (i == 0 || (left_next > 0.0) != (left > 0.0)) {
            other = guess;
            left_other = left;
        } else {
            left_other *= 0.5;
        }
        guess = next;
        left = left_next;
    }
    s->here.guess = s->known ? s->here.guess : s->here.excess;
    s->known = status <= WARNING;
    return status;
}

/* At the end of the initialisation, the inner slave gets the first inputs. */
static int enter(slave *s)
{
    mrd_state here = s->damper;
    return lead_inner(s, &here, 0.0);
}

static int get(slave *s, unsigned which, double *value)
{
    for (int i = 0; i < QUANTITIES; i++) {
        if (origin[i] != DERIVED && which == references[i]) {
            *value = s->input[i] * factors[i];
            return OK;
        }
    }
    if (which - first_reference < EFFECTS) {
        *value = s->damper.parameters[FIRST_EFFECT + which - first_reference];
        return OK;
    }
    if (which != force_reference) {
        const int status = FOLLOWS_AT_ONCE ? pass(s) : OK;
        return status > WARNING ? status : inner_get(s, which, value);
    }
    if (!FOLLOWS_AT_ONCE && !s->damper.moved) {
        return inner_get(s, which, value);
    }
    const int status = FOLLOWS_AT_ONCE ? pass(s) : OK;
    *value = s->force;
    return status;
}

static int set(slave *s, unsigned which, double value)
{
    s->known = 0;
    for (int i = 0; i < QUANTITIES; i++) {
        if (origin[i] != DERIVED && which == references[i]) {
            if (!isfinite(value)) {
                return refuse(s, "an input is not finite");
            }
            s->input[i] = s->now[i] = value / factors[i];
            return OK;
        }
    }
    if (which - first_reference < EFFECTS) {
        return set_parameter(s, &s->damper, FIRST_EFFECT + which - first_reference, value);
    }
    return inner_set(s, &which, 1, &value);
}

static int step_to(slave *s, double time, double step)
{
    if (!(step > 0.0)) {
        return inner_step(s, time, step);
    }
    if (!FOLLOWS_AT_ONCE) {
        s->here = s->damper;
    }
    int status = FOLLOWS_AT_ONCE ? pass(s) : lead_inner(s, &s->here, step);
    if (status <= WARNING) {
        status = inner_step(s, time, step);
    }
    if (status <= WARNING && !FOLLOWS_AT_ONCE) {
        status = follow_inner(s, &s->here);
    }
    if (status > WARNING) {
        return status;
    }
    s->damper = s->here;
    s->known = 0;
    s->elapsed = step;
    if (FOLLOWS_AT_ONCE) {
        s->now[POSITION] += step * (s->now[VELOCITY] + 0.5 * step * s->now[ACCELERATION]);
        s->now[VELOCITY] += step * s->now[ACCELERATION];
    }
    return status;
}

/*
 * $title: force of a magnetorheological damper from the motion of its rod and the current of its coil.
 *
$equation
 *
$source
$effects *
 * C99; needs the C library and its mathematics (-lm), nothing else. Generated from Python by mrd_sim: do not edit.
 * SI units; position > 0 extends the damper, force > 0 resists extension.
 *
 *   ${p}_state damper;
 *   ${p}_init(&damper);
 *   damper.parameters[$example] = ...;  // where another value than the fitted one is wanted
 *   force = ${p}_step(&damper, dt, position, velocity, acceleration, current$simulator_argument);
 *
 * Other files see the declarations by #define ${P}_DECLARATIONS and #include of this file.
 */
#ifndef ${P}_DECLARED
#define ${P}_DECLARED

enum {
$indices
    ${P}_PARAMETERS
};

/* Values as fitted, and the bounds between which the model is known to be sound; in the order of the enumeration. */
typedef struct {
    const char *name, *unit;
    double value, lower, upper;
} ${p}_parameter;
extern const ${p}_parameter ${p}_parameters[${P}_PARAMETERS];

/* A point of the path: step that leads to it, motion of the rod, current of the coil, effective current, force. */
typedef struct {
    double dt, x, v, a, current, effective, force;
} ${p}_vertex;

/* A damper with its parameters and its present state. It may be copied. */
typedef struct {
    double parameters[${P}_PARAMETERS];
    double inner[$states];                             /* of the coil, the model, the effects; elongations in series, force */
    double position, velocity, acceleration, current;  /* at the sample before, from mid-stroke */
$plain_state    int moved;                                         /* whether there was such a sample */
} ${p}_state;

/* A damper at rest, unloaded, with the fitted parameters. Its coil has the current of the first step. */
void ${p}_init(${p}_state *s);

/*
 * Advance the damper by dt (s) to a sample of position (m), velocity (m/s), acceleration (m/s^2) and coil current (A);
 * returns its force (N) as it is measured. The first step only sets where the damper is, whatever its dt; so does a later
 * one with dt = 0. Where the velocity has changed its sign, the turning point in between is passed too.
$simulator_comment */
double ${p}_step(
    ${p}_state *s, double dt, double position, double velocity, double acceleration, double current$simulator_parameter);
$through_declaration
#endif

#ifndef ${P}_DECLARATIONS
#include <math.h>
#include <string.h>

const ${p}_parameter ${p}_parameters[${P}_PARAMETERS] = {
$table
};

/* Coefficients of the model, in the order in which a row holds them. */
enum {
$columns,
    COEFFICIENTS
};

/* For each coefficient its current law, where the law's parameters are, and its least value. */
enum { LAW_PARAMETERS = 3 };
static const int codes[] = {$codes};
static const int columns[] = {$law_columns};
static const double floors[] = {$floors};

$functions
${series}/* Effects before the damper change motion and current in a vertex, and the damper answers; its force includes what is added. */
static void lead(${p}_state *s, ${p}_vertex *p, double added)
{
    double q[COEFFICIENTS];
$before    $lag(1, s->parameters + ${P}_COIL_LAG, s->inner, &p->dt, &p->current, &p->effective);
    $laws(1, s->parameters, codes, columns, floors, &p->effective, q);
    $damper
}

/* Effects behind the damper; returns the force that they leave. */
static double follow(${p}_state *s, ${p}_vertex *p)
{
$after    return p->force;
}

/*
 * The vertices that lead to a sample: the turning point before it, where the velocity has changed its sign, and the sample.
 * Returns how many; share is the instant of the turning point, from 0 to 1.
 */
static int vertices(
    ${p}_state *s, double dt, double position, double velocity, double acceleration, double current, ${p}_vertex p[2],
    double *share)
{
    if (!s->moved) {
        dt = 0.0;
    }
    position -= s->parameters[${P}_MID_STROKE];
    /* Where the linear velocity is zero; rounding may put it on a sample. */
    const double f = s->velocity * velocity < 0.0 ? s->velocity / (s->velocity - velocity) : 0.0, g = 1.0 - f;
    const int turns = dt > 0.0 && f > 0.0 && f < 1.0;
    if (turns) {
        /* The turning point follows from the cubic through both samples with their velocities. */
        const double turning = g * g * (1.0 + 2.0 * f) * s->position + f * g * g * dt * s->velocity
                               + f * f * (1.0 + 2.0 * g) * position - f * f * g * dt * velocity;
        const double bend = g * s->acceleration + f * acceleration, between = g * s->current + f * current;
        p[0] = (${p}_vertex){.dt = f * dt, .x = turning, .a = bend, .current = between};
    }
    p[turns] = (${p}_vertex){turns ? g * dt : dt, position, velocity, acceleration, current, 0.0, 0.0};
    s->position = position;
    s->velocity = velocity;
    s->acceleration = acceleration;
    s->current = current;
    s->moved = 1;
    *share = f;
    return 1 + turns;
}
$plain_function
void ${p}_init(${p}_state *s)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < ${P}_PARAMETERS; i++) {
        s->parameters[i] = ${p}_parameters[i].value;
    }
$start}

double ${p}_step(
    ${p}_state *s, double dt, double position, double velocity, double acceleration, double current$simulator_parameter)
{
    ${p}_vertex p[2];
    double share, force = 0.0;
    const int count = vertices(s, dt, position, velocity, acceleration, current, p, &share);
$find_excess    for (int i = 0; i < count; i++) {
        lead(s, p + i, $added);
        force = follow(s, p + i);
    }
$keep_excess    return force;
}
$through#endif

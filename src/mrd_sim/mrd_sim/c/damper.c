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

/* A damper with its parameters and its present state. It may be copied. */
typedef struct {
    double parameters[${P}_PARAMETERS];
    double inner[$states];                             /* of the coil, the model, the effects; elongations in series, force */
    double position, velocity, acceleration, current;  /* at the sample before */
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
${series}static double vertex(${p}_state *s, double dt, double x, double v, double a, double current$excess_parameter)
{
    double effective, q[COEFFICIENTS], force = 0.0;
$before    $lag(1, s->parameters + ${P}_COIL_LAG, s->inner, &dt, &current, &effective);
    $laws(1, s->parameters, codes, columns, floors, &effective, q);
    $damper
$add_excess$after    return force;
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
    if (!s->moved) {
        dt = 0.0;
    }
    /* Instant between both samples, from 0 to 1, at which the linear velocity is zero; rounding may put it on a sample. */
    const double f = s->velocity * velocity < 0.0 ? s->velocity / (s->velocity - velocity) : 0.0, g = 1.0 - f;
    const int turns = dt > 0.0 && f > 0.0 && f < 1.0;
    /* The turning point follows from the cubic through both samples with their velocities. */
    const double turning = g * g * (1.0 + 2.0 * f) * s->position + f * g * g * dt * s->velocity
                           + f * f * (1.0 + 2.0 * g) * position - f * f * g * dt * velocity;
    const double bend = g * s->acceleration + f * acceleration, between = g * s->current + f * current;
$find_excess    if (turns) {
        vertex(s, f * dt, turning, 0.0, bend, between$excess_between);
    }
    dt *= turns ? g : 1.0;
    s->position = position;
    s->velocity = velocity;
    s->acceleration = acceleration;
    s->current = current;
    s->moved = 1;
$keep_excess    return vertex(s, dt, position, velocity, acceleration, current$excess_now);
}
#endif

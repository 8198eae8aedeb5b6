/*
 * Both Bouc-Wen models as one would write them in C: the peer of benchmarks/integration.py.
 *
 * The same scheme as mrd_sim's: exact coil lag, coefficients affine in the effective current, exact hysteresis (n = 2)
 * from vertex to vertex, a step of fourth order for the element in series with a dashpot; everything in one pass, nothing
 * stored but the force.
 */
#include <math.h>

/* State after the rod moved by travel (in yield travels), sigma = gamma / (beta + gamma). */
static double advance(double w, double travel, double sigma)
{
    const double direction = travel > 0.0 ? 1.0 : -1.0;
    double h = direction * travel, v = direction * w;
    if (v < 0.0) {
        const double root = sqrt(2.0 * sigma - 1.0), angle = root * h;
        if (angle < 1.5) {
            const double turned = tan(angle), left = -v * root;
            if (turned < left) {
                return direction * (turned - left) / (root * (1.0 + left * turned));
            }
        }
        h -= atan(-v * root) / root;
        v = 0.0;
    }
    const double rest = (1.0 - v) * exp(-2.0 * h);
    return direction * (1.0 + v - rest) / (1.0 + v + rest);
}

/* The coil: effective and measured current at the vertex before, and how far the first decays over the last step. */
typedef struct {
    double u, current, step, decay;
} coil;

/* Effective current after the coil's lag, the measured one being linear between two vertices. */
static double lagged(coil *c, double current, double dt, double lag)
{
    if (dt == 0.0 || lag < 1e-9) {
        c->u = current - (dt > 0.0 ? lag * (current - c->current) / dt : 0.0);
    } else {
        if (fabs(dt - c->step) > 1e-9 * c->step) {
            c->step = dt;
            c->decay = exp(-dt / lag);
        }
        const double rise = (current - c->current) / c->step * lag;
        c->u = (current - rise) + (c->u - (c->current - rise)) * c->decay;
    }
    c->current = current;
    return c->u;
}

typedef struct {
    double yield_force, yield_force_per_A, yield_travel, yield_travel_per_A, shape, exponent;
    double viscous, viscous_per_A, stiffness, offset, mid_stroke, coil_lag;
} bouc_wen_parameters;

void bouc_wen(const bouc_wen_parameters *p, long vertices, const double *dt, const double *x, const double *v,
              const double *current, const char *is_sample, double *force)
{
    coil c = {current[0], current[0], 0.0, 0.0};
    double w = 0.0;
    for (long k = 0; k < vertices; k++) {
        const long before = k ? k - 1 : 0;
        const double u = lagged(&c, current[k], dt[k], p->coil_lag);
        const double yield_force = p->yield_force + p->yield_force_per_A * u;
        const double yield_travel = fmax(p->yield_travel + p->yield_travel_per_A * u, 2e-6);
        const double viscous = p->viscous + p->viscous_per_A * u;
        w = advance(w, (x[k] - x[before]) / yield_travel, p->shape);
        if (is_sample[k]) {
            *force++ = yield_force * w + viscous * v[k] + p->stiffness * x[k] + p->offset;
        }
    }
}

typedef struct {
    double yield_force, yield_force_per_A, yield_travel, yield_travel_per_A, shape, exponent;
    double viscous, viscous_per_A, series_viscous, series_viscous_per_A, stiffness, accumulator_stiffness, offset;
    double mid_stroke, coil_lag;
} modified_bouc_wen_parameters;

/* Travel of the element in m or in yield travels, and the state after it. */
typedef struct {
    double travel, after;
} outcome;

/* States after a travel, in yield travels, and after twice as much. */
static void advance_twice(double w, double travel, double sigma, double *middle, double *after)
{
    const double direction = travel >= 0.0 ? 1.0 : -1.0, h = direction * travel, v = direction * w;
    const double b = v >= 0.0 ? 1.0 : 1.0 - 2.0 * sigma, z = b * h * h;
    if (fabs(z) <= 0.25) {
        const double p = h * (945.0 + z * (105.0 + z)), q = 945.0 + z * (420.0 + 15.0 * z);
        const double after_p = 2.0 * p * q, after_q = q * q + b * p * p;
        *after = direction * (v * after_q + after_p) / (after_q + b * v * after_p);
        if (v >= 0.0 || direction * *after <= 0.0) {
            *middle = direction * (v * q + p) / (q + b * v * p);
            return;
        }
    }
    *middle = advance(w, travel, sigma);
    *after = advance(w, 2.0 * travel, sigma);
}

/* Slope of the state over the travel. */
static double slope(double w, double direction, double sigma)
{
    return 1.0 - (direction * w >= 0.0 ? 1.0 : 1.0 - 2.0 * sigma) * w * w;
}

/* Weight of a step's end. */
static double implicit_weight(double decay)
{
    return (3.0 + decay) / (6.0 + decay);
}

/* The travel d + creeping (w - mean of w), d being that with a state that stays. */
static outcome solved_travel(double w, double d, double creeping, double held, double bent, double change, double x_y,
                             double sigma)
{
    const double per_travel = 1.0 / x_y;
    d *= per_travel;
    creeping *= per_travel;
    bent *= per_travel;
    change *= per_travel;
    const double free = d + creeping * w;
    double direction = d >= 0.0 ? 1.0 : -1.0, stiffness = creeping * slope(w, direction, sigma);
    const double per_stiffness = (6.0 + stiffness) / (6.0 + stiffness * (4.0 + stiffness));
    const double bend = w * (direction * w >= 0.0 ? 1.0 / 3.0 : (1.0 - 2.0 * sigma) * (1.0 / 3.0));
    d *= per_stiffness;
    const double limit = fabs(d) * (1.0 / 3.0);
    bent = fmax(-limit, fmin(limit, bent - held * (1.0 / 12.0) * d));
    d += stiffness * per_stiffness * (bent + bend * fmin(d * d, 1.0));
    double middle, after;
    advance_twice(w, 0.5 * d, sigma, &middle, &after);
    if (direction * w > 1.0 - 1e-3) {
        return (outcome){d * x_y, direction * after > 1.0 - 1e-9 ? direction : after};
    }
    double slope_halfway = slope(middle, direction, sigma);
    stiffness = creeping * slope_halfway;
    const double relaxation = creeping * creeping * (1.0 / 36.0), rest = 1.0 - fmin(relaxation * relaxation, 1.0);
    const double smooth = rest * rest, half = smooth * creeping * (2.0 / 3.0);
    const double end = smooth * (creeping * (1.0 / 6.0 + (held + stiffness) * (1.0 / 12.0)) + change)
                       + (1.0 - smooth) * implicit_weight(creeping) * creeping;
    const double fixed = free - (creeping - half - end) * w + smooth * stiffness * bent;
    double low = fixed - half - end, high = fixed + half + end, last = high - low;
    for (int i = 0; i < 100; i++) {
        const double balance = d - fixed + half * middle + end * after;
        if (balance > 0.0) {
            high = d;
        } else {
            low = d;
        }
        const double slope_after = slope(after, direction, sigma);
        const double step = -balance / (1.0 + 0.5 * half * slope_halfway + end * slope_after);
        if (fabs(step) <= 3e-5 || high - low <= 1e-13) {
            return (outcome){(d + step) * x_y, after + slope_after * step};
        }
        if (low < d + step && d + step < high && 2.0 * fabs(step) < last) {
            last = fabs(step);
            d += step;
        } else {
            last = 0.5 * (high - low);
            d = 0.5 * (low + high);
        }
        direction = d >= 0.0 ? 1.0 : -1.0;
        advance_twice(w, 0.5 * d, sigma, &middle, &after);
        slope_halfway = slope(middle, direction, sigma);
    }
    return (outcome){d * x_y, after};
}

/* What acts on the element at an instant: its speed without resistance, F_y / (c0 + c1) and k0 / (c0 + c1). */
typedef struct {
    double drive, creep, pull;
} action;

/* Travel over one step without reversal; whole is the travel without resistance. */
static inline outcome travel_of_element(double w, double e, double dt, double whole, action before, action now, double x_y,
                                        double sigma)
{
    const double twelfth = dt * (1.0 / 12.0), held = 0.5 * dt * (before.pull + now.pull);
    const double per_scale = 1.0 / (1.0 + 0.5 * held), held_share = held * per_scale;
    const double change = (now.creep - before.creep) * twelfth;
    const double bent = (now.drive - before.drive) * twelfth - change * w;
    const double creeping = 0.5 * dt * (before.creep + now.creep) * per_scale;
    const double d = (whole * per_scale + held_share * bent) - creeping * w - held_share * e;
    if (fabs(w) < 1.0 || !(w * d > 0.0)) {
        return solved_travel(w, d, creeping, held_share, bent, change * per_scale, x_y, sigma);
    }
    return (outcome){d, w};
}

/* The same where the element reverses after a part of the step. */
static outcome travel_with_reversal(double part, double w, double e, double dt, double whole, action before, action now,
                                    double x_y, double sigma)
{
    const double left = 1.0 - part;
    const double first = part * part * (3.0 - 2.0 * part) * whole
                         + part * left * dt * (left * before.drive - part * now.drive);
    const action turn = {
        6.0 * part * left * whole / dt + left * (1.0 - 3.0 * part) * before.drive + part * (3.0 * part - 2.0) * now.drive,
        left * before.creep + part * now.creep,
        left * before.pull + part * now.pull,
    };
    const outcome there = travel_of_element(w, e, part * dt, first, before, turn, x_y, sigma);
    outcome back = travel_of_element(there.after, e + there.travel, left * dt, whole - first, turn, now, x_y, sigma);
    back.travel += there.travel;
    return back;
}

void modified_bouc_wen(const modified_bouc_wen_parameters *p, long vertices, const double *dt, const double *x,
                       const double *v, const double *current, const char *is_sample, double *force)
{
    coil c = {current[0], current[0], 0.0, 0.0};
    double w = 0.0, e = 0.0, position = x[0], share = 0.0, speed = 0.0, x_y = 0.0;
    action before = {0.0, 0.0, 0.0};
    for (long k = 0; k < vertices; k++) {
        const double u = lagged(&c, current[k], dt[k], p->coil_lag);
        const double yield_force = fmax(p->yield_force + p->yield_force_per_A * u, 0.0);
        const double yield_travel = fmax(p->yield_travel + p->yield_travel_per_A * u, 2e-6);
        const double c0 = fmax(p->viscous + p->viscous_per_A * u, 0.0);
        const double c1 = fmax(p->series_viscous + p->series_viscous_per_A * u, 1e3);
        const double per_viscous = 1.0 / (c0 + c1), share_now = c1 * per_viscous;
        const action now = {share_now * v[k], yield_force * per_viscous, p->stiffness * per_viscous};
        if (dt[k] > 0.0) {
            const double whole = 0.5 * (share + share_now) * (x[k] - position), middle = 0.5 * (x_y + yield_travel);
            outcome step = travel_of_element(w, e, dt[k], whole, before, now, middle, p->shape);
            const double speed_now = now.drive - now.creep * step.after - now.pull * (e + step.travel);
            if (speed * speed_now < 0.0) {
                const double part = speed / (speed - speed_now);
                step = travel_with_reversal(part, w, e, dt[k], whole, before, now, middle, p->shape);
            }
            w = step.after;
            e += step.travel;
        }
        position = x[k];
        share = share_now;
        before = now;
        x_y = yield_travel;
        speed = now.drive - now.creep * w - now.pull * e;
        if (is_sample[k]) {
            *force++ = c1 * (v[k] - speed) + p->accumulator_stiffness * x[k] + p->offset;
        }
    }
}

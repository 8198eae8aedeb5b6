/*
 * Both Bouc-Wen models as one would write them in C: the peer of benchmarks/integration.py.
 *
 * The same scheme as mrd_sim's: exact coil lag, coefficients affine in the effective current, exact hysteresis (n = 2)
 * from vertex to vertex, Newton's method for the internal node; everything in one pass, nothing stored but the force.
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
    double viscous, viscous_per_A, stiffness, offset, coil_lag;
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
    double viscous, viscous_per_A, series_viscous, series_viscous_per_A, stiffness, accumulator_stiffness, offset, coil_lag;
} modified_bouc_wen_parameters;

void modified_bouc_wen(const modified_bouc_wen_parameters *p, long vertices, const double *dt, const double *x,
                       const double *v, const double *current, const char *is_sample, double *force)
{
    coil c = {current[0], current[0], 0.0, 0.0};
    double w = 0.0, y = x[0];
    for (long k = 0; k < vertices; k++) {
        const long before = k ? k - 1 : 0;
        const double u = lagged(&c, current[k], dt[k], p->coil_lag);
        const double yield_force = fmax(p->yield_force + p->yield_force_per_A * u, 0.0);
        const double yield_travel = fmax(p->yield_travel + p->yield_travel_per_A * u, 2e-6);
        const double c0 = fmax(p->viscous + p->viscous_per_A * u, 0.0);
        const double c1 = fmax(p->series_viscous + p->series_viscous_per_A * u, 1e3);
        if (dt[k] > 0.0) {
            /* d (c0 + c1) = dt (F_y ((1 - theta) w + theta w+(travel - d)) + k0 (middle - d / 2)) + c0 travel */
            const double travel = x[k] - x[before], middle = 0.5 * (x[k] + x[before]) - y;
            const double scale = c0 + c1 + 0.5 * dt[k] * p->stiffness;
            const double per_scale = 1.0 / scale, per_travel = 1.0 / yield_travel;
            const double whole = dt[k] * yield_force, decay = whole * per_travel * per_scale;
            const double push = (3.0 + decay) / (6.0 + decay) * whole, reach = push * per_scale;
            const double fixed = c0 * travel + dt[k] * p->stiffness * middle + (whole - push) * w;
            double d = (fixed + push * w) * per_scale, after = w;
            double low = d - (1.0 + w) * reach, high = d + (1.0 - w) * reach, last = high - low;
            for (int i = 0; i < 100; i++) {
                const double element = travel - d, direction = element >= 0.0 ? 1.0 : -1.0;
                after = advance(w, element * per_travel, p->shape);
                const double balance = scale * d - fixed - push * after;
                if (balance > 0.0) {
                    high = d;
                } else {
                    low = d;
                }
                const double along = direction * after;
                const double bend = (1.0 - (along >= 0.0 ? 1.0 : 1.0 - 2.0 * p->shape) * along * along) * per_travel;
                const double step = -balance / (scale + push * bend);
                if (fabs(step) <= 1e-7 * yield_travel || high - low <= 1e-13 * yield_travel) {
                    d += step;
                    after -= bend * step;
                    break;
                }
                if (low < d + step && d + step < high && 2.0 * fabs(step) < last) {
                    last = fabs(step);
                    d += step;
                } else {
                    last = 0.5 * (high - low);
                    d = 0.5 * (low + high);
                }
            }
            y += d;
            w = after;
        }
        if (is_sample[k]) {
            const double y_speed = (yield_force * w + c0 * v[k] + p->stiffness * (x[k] - y)) / (c0 + c1);
            *force++ = c1 * y_speed + p->accumulator_stiffness * x[k] + p->offset;
        }
    }
}

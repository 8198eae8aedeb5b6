/*
 * The elements in series share the rod's motion with the damper. The force is the one that leaves the damper a motion to which
 * the damper answers with that same force. The answer never rises with the force, so there is one such force.
 */
enum { ELEMENTS = $elements, ELONGATIONS = $elongations, FORCE_BEFORE = ELONGATIONS + ELEMENTS };
static const double shortest_step = $shortest;  /* s; in less nothing gives way, and speeds of elongation would be rounding */
static const double tolerance = 1e-9;  /* N */

/*
 * A force that is tried: what the damper answers beyond it, including what is added to its force, and the elongations and the
 * state of the damper that are left.
 */
typedef struct {
    double force, excess, elongations[ELEMENTS], inner[$states];
} trial;

static trial attempt(
    const ${p}_state *s, const double *q, double force, double added, double dt, double x, double v, double a)
{
    trial t = {.force = force};
    memcpy(t.elongations, s->inner + ELONGATIONS, sizeof t.elongations);
    memcpy(t.inner, s->inner, sizeof t.inner);
    if (dt > 0.0) {
$elongate    }
    for (int i = 0; i < ELEMENTS; i++) {
        x -= t.elongations[i];
        v -= dt > 0.0 ? (t.elongations[i] - s->inner[ELONGATIONS + i]) / dt : 0.0;
    }
    $kernel(1, q, t.inner + 2, &dt, &x, &v, &a, &t.excess);
    t.excess += added - force;
    return t;
}

/* By false position between a force and the damper's answer to it; in between by halving, which never fails. */
static double force_in_series(
    ${p}_state *s, const double *q, double added, double dt, double x, double v, double a)
{
    if (0.0 < dt && dt < shortest_step) {
        return s->inner[FORCE_BEFORE];
    }
    trial other = attempt(s, q, s->inner[FORCE_BEFORE], added, dt, x, v, a);
    trial t = attempt(s, q, other.force + other.excess, added, dt, x, v, a);
    for (int i = 1; i < 200 && fabs(t.excess) > tolerance && fabs(t.force - other.force) > tolerance; i++) {
        const double share = i % 3 ? t.excess / (t.excess - other.excess) : 0.5;
        const trial next = attempt(s, q, t.force + share * (other.force - t.force), added, dt, x, v, a);
        if ((next.excess > 0.0) != (t.excess > 0.0)) {
            other = t;
        } else {
            other.excess *= 0.5; /* pulls the next false position to the other side of the root (Illinois method) */
        }
        t = next;
    }
    memcpy(s->inner, t.inner, sizeof t.inner);
    memcpy(s->inner + ELONGATIONS, t.elongations, sizeof t.elongations);
    return s->inner[FORCE_BEFORE] = t.force;
}



/* Of all elements in series together. */
static double elongation(const ${p}_state *s)
{
    double sum = 0.0;
    for (int i = $first; i < $last; i++) {
        sum += s->inner[i];
    }
    return sum;
}

void ${p}_motion(
    ${p}_state *s, double dt, double position, double velocity, double acceleration, double current, double left[4])
{
    s->count = vertices(s, dt, position, velocity, acceleration, current, s->vertices, &s->share);
    for (int i = 0; i < s->count; i++) {
        ${p}_vertex *p = s->vertices + i;
        const double before = elongation(s);
        lead(s, p, s->guess);
        p->force -= s->guess;
        ${p}_vertex behind = *p;
        behind.x -= elongation(s);
        behind.v -= p->dt > 0.0 ? (elongation(s) - before) / p->dt : 0.0;
        s->answer = plain(s, &behind);
        left[0] = behind.x + s->parameters[${P}_MID_STROKE];
        left[1] = behind.v;
        left[2] = behind.a;
        left[3] = behind.current;
    }
}

double ${p}_force(${p}_state *s, double simulator)
{
    const double excess = simulator - s->answer;
    double force = 0.0;
    for (int i = 0; i < s->count; i++) {
        s->vertices[i].force += i + 1 < s->count ? (1.0 - s->share) * s->excess + s->share * excess : excess;
        force = follow(s, s->vertices + i);
    }
    /* A part of the difference: the whole would oscillate where the simulator is much stiffer than the model. */
    s->guess += 0.3 * (excess - s->guess);
    s->excess = excess;
    return force;
}

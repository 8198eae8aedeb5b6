
/* The model without effects, with the parameters with which it reproduces the simulator; returns its force. */
static double plain(${p}_state *s, const ${p}_vertex *at)
{
    static const double parameters[] = {$parameters};
    ${p}_vertex p = *at;
    double q[COEFFICIENTS];
    p.x += s->parameters[${P}_MID_STROKE] - parameters[$mid_stroke];
    p.force = 0.0;
    $lag(1, parameters + $coil_lag, s->plain, &p.dt, &p.current, &p.effective);
    $laws(1, parameters, codes, columns, floors, &p.effective, q);
    $kernel(1, q, s->plain + 2, &p.dt, &p.x, &p.v, &p.a, &p.force);
    return p.force;
}

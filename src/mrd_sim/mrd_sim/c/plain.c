
/* The model without effects, with the parameters with which it reproduces the simulator. */
static double plain(${p}_state *s, double dt, double x, double v, double a, double current)
{
    static const double parameters[] = {$parameters};
    double effective, q[COEFFICIENTS], force = 0.0;
    $lag(1, parameters + $place, s->plain, &dt, &current, &effective);
    $laws(1, parameters, codes, columns, floors, &effective, q);
    $kernel(1, q, s->plain + 2, &dt, &x, &v, &a, &force);
    return force;
}

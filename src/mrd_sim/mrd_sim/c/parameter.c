static int set_parameter(const slave *s, mrd_state *damper, int index, double value)
{
    const mrd_parameter *p = &mrd_parameters[index];
    char message[256];
    if (!(p->lower <= value && value <= p->upper)) {
        snprintf(message, sizeof message, "%s is %g, expected %.3g to %.3g %s", p->name, value, p->lower, p->upper, p->unit);
        return refuse(s, message);
    }
    damper->parameters[index] = value;
    return OK;
}

/* The inner slave by the interface of FMI 3.0. */

static int inner_begin(slave *s, const char *resources, int logging)
{
    char folder[3072], of_inner[3200];
    fmi3Instance (*call)(
        fmi3String, fmi3String, fmi3String, bool, bool, bool, bool, const fmi3ValueReference[], size_t, fmi3Environment,
        fmi3LogMessage, fmi3IntermediateUpdate);
    const char *const given = resources ? resources : "";
    const int length = (int)strlen(given), slash = length > 1 && (given[length - 1] == '/' || given[length - 1] == '\\');
    snprintf(folder, sizeof folder, "%.*s/inner", length - slash, given);
    if (open_library(s, folder, "$identifier")) {
        return ERROR;
    }
    snprintf(of_inner, sizeof of_inner, "%s/resources/", folder);
    if (find(s, "fmi3InstantiateCoSimulation", &call)) {
        s->inner = call(s->name, "$inner_guid", of_inner, false, logging, false, false, NULL, 0, s->host.environment,
                        s->host.log, NULL);
    }
    if (!s->inner) {
        close_library(s);
        return refuse(s, "the simulator inside cannot be instantiated");
    }
    return OK;
}

static void inner_end(slave *s)
{
    void (*call)(fmi3Instance);
    if (s->inner && find(s, "fmi3FreeInstance", &call)) {
        call(s->inner);
    }
}

static int inner_reset(slave *s)
{
    CALL(fmi3Reset, (fmi3Instance), (s->inner))
}
static int inner_set(const slave *s, const unsigned which[], size_t n, const double values[])
{
    CALL(fmi3SetFloat64, (fmi3Instance, const fmi3ValueReference[], size_t, const double[], size_t),
         (s->inner, which, n, values, n))
}
static int inner_get(const slave *s, unsigned which, double *value)
{
    CALL(fmi3GetFloat64, (fmi3Instance, const fmi3ValueReference[], size_t, double[], size_t), (s->inner, &which, 1, value, 1))
}
static int inner_step(slave *s, double time, double step)
{
    bool event = false, terminate = false, early = false;
    double reached = time + step;
    int (*call)(fmi3Instance, double, double, bool, bool *, bool *, bool *, double *);
    if (!find(s, "fmi3DoStep", &call)) {
        return ERROR;
    }
    const int status = call(s->inner, time, step, true, &event, &terminate, &early, &reached);
    s->terminate = terminate;
    return status;
}
static int keep(const slave *s, void **state)
{
    CALL(fmi3GetFMUState, (fmi3Instance, fmi3FMUState *), (s->inner, state))
}
static int restore(const slave *s, void *state)
{
    CALL(fmi3SetFMUState, (fmi3Instance, fmi3FMUState), (s->inner, state))
}
static int forget(const slave *s, void **state)
{
    CALL(fmi3FreeFMUState, (fmi3Instance, fmi3FMUState *), (s->inner, state))
}

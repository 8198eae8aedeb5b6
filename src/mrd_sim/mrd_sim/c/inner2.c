/* The inner slave by the interface of FMI 2.0. */

/* Write the path of a file URI; what is no URI is a path. */
static void path_of(const char *uri, char *path, size_t size)
{
    const char *from = uri;
    if (strncmp(from, "file:", 5) == 0) {
        from += 5;
        if (strncmp(from, "//", 2) == 0) {
            from = strchr(from + 2, '/');
        }
    }
#if defined _WIN32
    if (from && from[0] == '/' && from[1] && from[2] == ':') {
        from++;
    }
#endif
    size_t n = 0;
    for (; from && *from && n + 1 < size; from++) {
        unsigned code;
        if (*from == '%' && from != uri && sscanf(from + 1, "%2x", &code) == 1) {
            path[n++] = (char)code;
            from += 2;
        } else {
            path[n++] = *from;
        }
    }
    while (n > 1 && path[n - 1] == '/') {
        n--;
    }
    path[n] = 0;
}

static int inner_begin(slave *s, const char *resources, int logging)
{
    char folder[3072], of_inner[3200];
    fmi2Component (*call)(
        fmi2String, fmi2Type, fmi2String, fmi2String, const fmi2CallbackFunctions *, fmi2Boolean, fmi2Boolean);
    path_of(resources ? resources : "", folder, sizeof folder - 8);
    strcat(folder, "/inner");
    if (open_library(s, folder, "$identifier")) {
        return ERROR;
    }
    const int length = (int)strlen(resources), slash = length > 0 && resources[length - 1] == '/';
    snprintf(of_inner, sizeof of_inner, "%.*s/inner/resources", length - slash, resources);
    if (find(s, "fmi2Instantiate", &call)) {
        s->inner = call(s->name, fmi2CoSimulation, "$inner_guid", of_inner, s->host, 0, logging);
    }
    if (!s->inner) {
        close_library(s);
        return refuse(s, "the simulator inside cannot be instantiated");
    }
    return OK;
}

static void inner_end(slave *s)
{
    void (*call)(fmi2Component);
    if (s->inner && find(s, "fmi2FreeInstance", &call)) {
        call(s->inner);
    }
}

static int inner_reset(slave *s)
{
    CALL(fmi2Reset, (fmi2Component), (s->inner))
}
static int inner_set(const slave *s, const unsigned which[], size_t n, const double values[])
{
    CALL(fmi2SetReal, (fmi2Component, const fmi2ValueReference[], size_t, const fmi2Real[]), (s->inner, which, n, values))
}
static int inner_get(const slave *s, unsigned which, double *value)
{
    CALL(fmi2GetReal, (fmi2Component, const fmi2ValueReference[], size_t, fmi2Real[]), (s->inner, &which, 1, value))
}
static int inner_step(slave *s, double time, double step)
{
    CALL(fmi2DoStep, (fmi2Component, fmi2Real, fmi2Real, fmi2Boolean), (s->inner, time, step, 1))
}
static int keep(const slave *s, void **state)
{
    CALL(fmi2GetFMUstate, (fmi2Component, fmi2FMUstate *), (s->inner, state))
}
static int restore(const slave *s, void *state)
{
    CALL(fmi2SetFMUstate, (fmi2Component, fmi2FMUstate), (s->inner, state))
}
static int forget(const slave *s, void **state)
{
    CALL(fmi2FreeFMUstate, (fmi2Component, fmi2FMUstate *), (s->inner, state))
}

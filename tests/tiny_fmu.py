"""FMUs of a few lines of C, built for tests: dampers, well and ill."""

import subprocess
import zipfile
from pathlib import Path

from mrd_sim.fmu import platform_folder

SOURCE = r"""
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
typedef struct { double u[5], force, state; int steps, fixed; void *logger, *environment; } damper;
typedef void (*message)(void *, const char *, int, const char *, const char *, ...);
typedef struct { message logger; void *allocate, *free, *finished, *environment; } callbacks;
static const callbacks *host;
static int said(int status, const char *text)
{
    host->logger(host->environment, "tiny", status, "logStatusError", "%s", text);
    return status;
}
static double force_of(damper *d)
{
    const double x = d->u[0], v = d->u[1], i = d->u[2], c = d->u[4];
    (void)x, (void)v, (void)i, (void)c;
    return FORCE;
}
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const callbacks *f, int v, int l)
{
    host = f;
    damper *d = calloc(1, sizeof *d);
    d->u[4] = 900.0;
    INSTANTIATE
    return d;
}
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const names[]) { return 0; }
int fmi2SetupExperiment(void *c, int a, double b, double s, int e, double f) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { damper *d = c; (void)d; INITIALIZE return 0; }
int fmi2Terminate(void *c) { return 0; }
int fmi2Reset(void *c) { damper *d = c; memset(d->u, 0, sizeof d->u); d->u[4] = 900.0; d->state = 0.0; return 0; }
int fmi2SetReal(void *c, const unsigned which[], size_t n, const double values[])
{
    damper *d = c;
    for (size_t k = 0; k < n; k++) {
        d->u[which[k]] = values[k];
    }
    if (AT_ONCE) {
        d->force = force_of(d);
    }
    return 0;
}
int fmi2GetReal(void *c, const unsigned which[], size_t n, double values[])
{
    damper *d = c;
    for (size_t k = 0; k < n; k++) {
        values[k] = which[k] == 3 ? d->force : d->u[which[k]];
    }
    return 0;
}
int fmi2DoStep(void *c, double time, double h, int last)
{
    damper *d = c;
    d->steps++;
    STEP
    d->force = force_of(d);
    return 0;
}
#define VALUES(name) int name(void *c, const unsigned which[], size_t n, void *values) { return n ? 3 : 0; }
VALUES(fmi2GetInteger) VALUES(fmi2GetBoolean) VALUES(fmi2GetString)
VALUES(fmi2SetInteger) VALUES(fmi2SetBoolean) VALUES(fmi2SetString)
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
"""

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="tiny" guid="{tiny}">
  <CoSimulation modelIdentifier="tiny" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions><Unit name="m"/><Unit name="m/s"/><Unit name="A"/><Unit name="N"/></UnitDefinitions>
  <ModelVariables>
    <ScalarVariable name="position" valueReference="0" causality="input"><Real start="0" unit="m"/></ScalarVariable>
    <ScalarVariable name="velocity" valueReference="1" causality="input"><Real start="0" unit="m/s"/></ScalarVariable>
    <ScalarVariable name="current" valueReference="2" causality="input"><Real start="0" unit="A"/></ScalarVariable>
    <ScalarVariable name="force" valueReference="3" causality="output"><Real unit="N"/></ScalarVariable>
    <ScalarVariable name="c" valueReference="4" causality="parameter" variability="tunable"><Real start="900"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="4"/></Outputs><InitialUnknowns><Unknown index="4"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def tiny_fmu(
    file: Path,
    force: str = "c * v + (20.0 + 300.0 * i) * tanh(v / 0.02)",
    *changes: tuple[str, str],
    at_once: bool = True,
    step: str = "",
    instantiate: str = "",
    initialize: str = "",
    files: dict[str, bytes] | None = None,
) -> Path:
    """Build an FMU of FMI 2.

    Parameters
    ----------
    file : Path
    force : str
        The force in C, of x, v, i and c.
    *changes : tuple of str
        Texts of the description, and what takes their places.
    at_once : bool
        Whether the force follows inputs at the same communication point.
    step, instantiate, initialize : str
        C code in these functions; ``d`` is the instance.
    files : mapping, optional
        Further files, or others in their place.
    """
    description = DESCRIPTION
    for before, after in changes:
        assert before in description
        description = description.replace(before, after)
    parts = {
        "FORCE": force,
        "AT_ONCE": str(int(at_once)),
        "STEP": step,
        "INSTANTIATE": instantiate,
        "INITIALIZE": initialize,
    }
    lines = [f"#define {name} {' '.join(text.split())}" for name, text in parts.items()]
    source = file.with_suffix(".c")
    source.write_text("\n".join(lines) + SOURCE, encoding="utf-8")
    library = file.with_suffix(".so")
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-lm"], check=True)
    content = {
        "modelDescription.xml": description.encode(),
        f"binaries/{platform_folder(2)}/tiny.so": library.read_bytes(),
        **(files or {}),
    }
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return file

"""FMUs with a Python inside, of FMI 2 and 3, whose force follows the inputs only after a step."""

import subprocess
import sys

FMI_2 = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real
import math

class Damper2(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x, self.v, self.i, self.F, self.c = 0.0, 0.0, 0.0, 0.0, 900.0
        for name in ("x", "v", "i"):
            self.register_variable(Real(name, causality=Fmi2Causality.input, start=0.0))
        self.register_variable(
            Real("c", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable, start=900.0)
        )
        self.register_variable(Real("F", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        self.F = self.c * self.v + (20.0 + 300.0 * self.i) * math.tanh(self.v / 0.02)
        return True
"""

FMI_3 = """
from pythonfmu3 import Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability
import math

class Damper3(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.x, self.v, self.i, self.F, self.c = 0.0, 0.0, 0.0, 0.0, 0.0, 900.0
        continuous, tunable = Fmi3Variability.continuous, Fmi3Variability.tunable
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, variability=continuous))
        for name in ("x", "v", "i"):
            self.register_variable(Float64(name, causality=Fmi3Causality.input, variability=continuous, start=0.0))
        self.register_variable(Float64("c", causality=Fmi3Causality.parameter, variability=tunable, start=900.0))
        self.register_variable(Float64("F", causality=Fmi3Causality.output, variability=continuous))

    def do_step(self, time, step):
        self.F = self.c * self.v + (20.0 + 300.0 * self.i) * math.tanh(self.v / 0.02)
        return True
"""


FMUS = {"Damper2": (FMI_2, "pythonfmu", "FMI 2.0"), "Damper3": (FMI_3, "pythonfmu3", "FMI 3.0")}
"""Source, package that exports it, and standard, by name."""


def build_fmu(folder, name):
    """Write an FMU into a folder; return its file."""
    text, exporter, _ = FMUS[name]
    source = folder / f"{name.lower()}.py"
    source.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", exporter, "build", "-f", source.name]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / f"{name}.fmu"

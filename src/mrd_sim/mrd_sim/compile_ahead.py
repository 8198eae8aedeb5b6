"""Compilation of models and effects in a process beside the one that needs them.

The first use on a machine compiles for half a minute, function by function. A second process, which begins at the other end
of the catalogue, writes what it compiles into the same cache, where the first one finds it.
"""

import contextlib
import subprocess
import sys
from functools import cache

import numpy as np

from mrd_base.compiling import AFTER, when_compiling
from mrd_base.errors import InputError
from mrd_base.workers import ending_with_parent
from mrd_sim.dual_type import as_duals
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS
from mrd_sim.path import make_path


def compile_beside() -> None:
    """Start a second process that compiles as well, as soon as this one is found to compile; it ends with this one."""
    when_compiling(_start, AFTER)


@cache
def _start() -> "subprocess.Popen[bytes] | None":
    with contextlib.suppress(OSError):  # without it, the work takes longer, and is the same
        return subprocess.Popen(
            ending_with_parent([sys.executable, "-m", "mrd_sim.compile_ahead"]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    return None


def compile_ahead() -> None:
    """Compile all effects and models, the last ones first, for floats and for dual numbers."""
    time = np.arange(20) / 100.0
    position, current = 0.01 * np.sin(9.0 * time), 0.2 + 0.1 * np.cos(5.0 * time)
    velocity = np.gradient(position, time)
    path = make_path(time, position, velocity, np.gradient(velocity, time), current)
    bouc_wen = MODELS["bouc_wen"]
    effects = [bouc_wen.with_effects((effect,)) for effect in reversed(EFFECTS.values())]
    for model in [*effects, *reversed(MODELS.values())]:
        with contextlib.suppress(InputError, ArithmeticError):
            model.force(model.defaults, path)
            model.force(as_duals(model.defaults), path)


if __name__ == "__main__":
    compile_ahead()

"""An effect of the user's own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from mrd_sim.own import own_catalogue

USER_EFFECT = """
from numba import njit
from mrd_sim.effects import Effect
from mrd_sim.parameter import Parameter

@njit
def kernel(p, state, dt, x, v, a, u, force):
    for k in range(len(force)):
        force[k] += p[0] * x[k]

EFFECT = Effect(
    id="own_spring", title="Spring", stage="structure", equation="F + k x", source="mine",
    parameters=(Parameter("rate", "N/m", 0.0, 0.0, 1e4, "rate"),), typical={"rate": 1e3},
    signature="-", confused_with=("gas_spring",), separated_by="-", kernel=kernel,
)
"""


@pytest.fixture
def user_effects(tmp_path: Path) -> Iterator[Path]:
    """Return a folder with an effect of the user, and remove the effect from the catalogue afterwards."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "spring.py").write_text(USER_EFFECT)
    with own_catalogue():
        yield tmp_path / "own"

"""The word to the user where functions are compiled."""

import pytest
from numba import njit

from mrd_base.compiling import tell_when_compiling


@njit
def double(x: float) -> float:
    return 2.0 * x


@njit
def quadruple(x: float) -> float:
    return double(double(x))


def test_it_is_told_once_that_functions_are_compiled(capsys: pytest.CaptureFixture[str]) -> None:
    tell_when_compiling(after=0.0)
    quadruple(1.0)
    assert capsys.readouterr().err.startswith("compiling for this machine: only the first use does")
    double(1)  # for another type
    quadruple(2.0)
    assert capsys.readouterr().err == ""

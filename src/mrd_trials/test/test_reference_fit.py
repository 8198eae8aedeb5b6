"""The strength at which an effect reaches a target of its signal to floor."""

import numpy as np
import pytest

from mrd_trials.reference_fit import find_strength, orthonormal_basis


@pytest.mark.parametrize("power", [1.0, 2.0, 5.0])
def test_a_strength_reaches_its_target(power):
    strength, reached = find_strength(5.0, lambda size: 0.3 * size**power, 100.0)
    assert reached == 0.3 * strength**power == pytest.approx(5.0, rel=0.25)


def test_a_strength_is_limited():
    assert find_strength(5.0, lambda size: 1e-3 * size**2, 6.0) == (6.0, 1e-3 * 6.0**2)


def test_a_strength_beyond_a_threshold_is_found():
    def signal(size):
        return 1e-4 + 400.0 * max(size - 1.3, 0.0) ** 2

    strength, reached = find_strength(5.0, signal, 6.0)
    assert reached == signal(strength)
    assert abs(np.log(reached / 5.0)) < 0.25


def test_a_basis_spans_its_columns_once():
    columns = np.random.default_rng(0).normal(size=(50, 3)) * [1.0, 1e-6, 1e6]
    basis = orthonormal_basis(np.hstack([columns, columns[:, :1]]))
    assert basis.shape == (50, 3)
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(basis @ (basis.T @ columns), columns, rtol=1e-6, atol=1e-9)

"""Names of runs in sentences."""

import pytest

from mrd_runs.text import named_run


@pytest.mark.parametrize(("name", "named"), [("02_sine", "run 02_sine"), ("run2", "run2"), ("Run 7", "Run 7")])
def test_a_run_is_not_called_run_twice(name, named):
    assert named_run(name) == named

"""Compiled functions never outlive a change of what they call."""

import os

from mrd_sim.stale_kernels import delete_stale_kernels


def test_compiled_functions_older_than_any_compiled_source_go(tmp_path):
    cache = tmp_path / "models" / "__pycache__"
    cache.mkdir(parents=True)
    stale, fresh, other = cache / "old.nbi", cache / "new.nbi", cache / "old.pyc"
    called, unrelated = tmp_path / "hysteresis.py", tmp_path / "cli.py"
    called.write_text("from numba import njit")
    unrelated.write_text("print()")
    for path, age in ((stale, 1), (other, 1), (called, 2), (fresh, 3), (unrelated, 4)):
        path.touch()
        os.utime(path, (age, age))
    delete_stale_kernels(tmp_path)
    assert not stale.exists()
    assert fresh.exists()
    assert other.exists()

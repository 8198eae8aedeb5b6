"""A second process compiles what the first one will need."""

import os
import subprocess
import sys

import pytest
from numba import njit

from mrd_sim import compile_ahead

COMPILED = """
from numba.core.event import Listener, register

class Count(Listener):
    names = []
    def on_start(self, event): pass
    def on_end(self, event): self.names.append(event.data["dispatcher"].py_func.__module__)

register("numba:compile", Count())
from mrd_sim.compile_ahead import compile_ahead
compile_ahead()
print(*(name for name in Count.names if name.startswith("mrd_sim.effects")))
"""


@njit
def doubled(x: float) -> float:
    return 2.0 * x


def test_the_second_process_is_started_once_and_only_where_something_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    started = []
    monkeypatch.setattr(compile_ahead, "AFTER", 0.0)
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: started.append(command))
    compile_ahead._start.cache_clear()
    compile_ahead.compile_beside()
    compile_ahead.compile_beside()
    assert not started
    doubled(1.0)
    doubled(1)
    assert [command[-2:] for command in started] == [["-m", "mrd_sim.compile_ahead"]]


@pytest.mark.slow
def test_what_one_process_has_compiled_ahead_another_one_finds(tmp_path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", COMPILED], env=environment, check=True, capture_output=True, text=True)
        for _ in range(2)
    )
    assert len(first.stdout.split()) > 50
    assert second.stdout.split() == []

"""The same work on a dask cluster of separate processes gives the same results, also when a worker dies."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import psutil
import pytest
from distributed import Client

from mrd_base import InputError
from mrd_identification.cluster import run_on_cluster
from mrd_identification.compare import compare

from .test_compare import simulated


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler with two workers, each a process of its own without a nanny."""
    address_file = tmp_path / "scheduler.json"
    common = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes = [
        subprocess.Popen(
            [
                sys.executable,
                "-m",
                "distributed.cli.dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                "0",
                "--no-dashboard",
                "--scheduler-file",
                str(address_file),
            ],
            **common,
        )
    ]
    deadline = time.monotonic() + 30
    while not address_file.exists():
        assert time.monotonic() < deadline, "the scheduler did not start"
        time.sleep(0.05)
    processes += [
        subprocess.Popen(
            [
                sys.executable,
                "-m",
                "distributed.cli.dask_worker",
                "--scheduler-file",
                str(address_file),
                "--no-nanny",
                "--nthreads",
                "1",
                "--host",
                "127.0.0.1",
                "--no-dashboard",
                "--local-directory",
                str(tmp_path),
            ],
            **common,
        )
        for _ in range(2)
    ]
    with Client(scheduler_file=str(address_file), set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        address = client.scheduler.address
    yield address
    for process in processes:
        process.kill()
        process.wait()


def test_a_cluster_gives_what_this_machine_gives(cluster):
    runs, held_out = [simulated("a", 1), simulated("b", 2)], [simulated("c", 3)]
    options = {"held_out": held_out, "population": 16, "generations": 4, "seeds": 2}
    here = compare(runs, ["bingham", "bouc_wen:tanh"], **options)
    there = compare(runs, ["bingham", "bouc_wen:tanh"], scheduler=cluster, **options)
    for ours, theirs in zip(here.entries, there.entries, strict=True):
        assert ours.name == theirs.name
        assert np.array_equal(ours.fit.theta, theirs.fit.theta)
        assert (ours.nrmse, ours.lower, ours.upper) == (theirs.nrmse, theirs.lower, theirs.upper)
        assert theirs.fit.model.laws == ours.fit.model.laws


def slow_pid(data, number):
    """Weigh a number, slowly, and say who did it."""
    time.sleep(0.5)
    return number * data[0].sum(), os.getpid()


def test_a_dead_worker_costs_what_it_was_at(cluster):
    done, data = [], (np.ones(1000),)
    with Client(cluster, set_as_default=False) as client:
        victim = next(iter(client.run(os.getpid).values()))
    killer = threading.Timer(1.2, os.kill, (victim, signal.SIGKILL))
    killer.start()
    found = run_on_cluster(cluster, slow_pid, [(data, number) for number in range(10)], done.append)
    assert [weighed for weighed, _ in found] == [1000 * number for number in range(10)]
    killer.join()
    assert done == list(range(1, 11))
    assert any(worker != victim for _, worker in found)
    assert psutil.Process(victim).status() == psutil.STATUS_ZOMBIE


def test_no_scheduler_is_one_line(monkeypatch):
    monkeypatch.setattr("mrd_identification.cluster.CONNECT_TIMEOUT", 1.0)
    with pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no dask scheduler answers"):
        run_on_cluster("tcp://127.0.0.1:9", slow_pid, [((), 1)])
    with pytest.raises(InputError, match="--scheduler nonsense:x:y: expected the address of a dask scheduler"):
        run_on_cluster("nonsense:x:y", slow_pid, [((), 1)])

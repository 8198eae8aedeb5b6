"""A dask cluster of separate processes gives the same results as this machine, also when a worker dies."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
from distributed import Client

from mrd_base import InputError
from mrd_identification.cluster import run_on_cluster
from mrd_identification.compare import compare

from .test_compare import simulate


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Start a scheduler and two workers, each a separate process without a nanny, and return the scheduler's address."""
    folder = tmp_path_factory.mktemp("cluster")
    address_file = folder / "scheduler.json"
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
    wait_for(address_file.exists)
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
                str(folder),
            ],
            **common,
        )
        for _ in range(2)
    ]
    with Client(scheduler_file=str(address_file), set_as_default=False) as client:
        client.wait_for_workers(2, timeout=240)
        address = client.scheduler.address
    yield address
    for process in processes:
        process.kill()
        process.wait()


def test_a_cluster_gives_the_results_of_this_machine(cluster):
    runs, held_out = [simulate("a", 1), simulate("b", 2)], [simulate("c", 3)]
    options = {"held_out": held_out, "population": 16, "generations": 4, "seeds": 2}
    here = compare(runs, ["bingham", "bouc_wen:tanh", "linear_viscous+auto"], **options)
    there = compare(runs, ["bingham", "bouc_wen:tanh", "linear_viscous+auto"], scheduler=cluster, **options)
    for local, remote in zip(here.entries, there.entries, strict=True):
        assert local.name == remote.name
        assert np.array_equal(local.fit.theta, remote.fit.theta)
        assert (local.nrmse, local.lower, local.upper) == (remote.nrmse, remote.lower, remote.upper)
        assert remote.fit.model.laws == local.fit.model.laws


def weigh(data, number, folder):
    """Weigh a number and return the process id; later numbers only return once the file ``go`` is there."""
    (folder / f"started-{os.getpid()}").touch()
    if number > 1:
        wait_for((folder / "go").exists)
    return number * data[0].sum(), os.getpid()


def wait_for(condition, seconds=240.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "timed out"
        time.sleep(0.01)


def test_the_work_of_a_dead_worker_is_done_by_the_others(cluster, tmp_path):
    """The last test with the cluster, which then has one worker only."""
    data = (np.ones(1000),)
    with Client(cluster, set_as_default=False) as client:
        victim = next(iter(client.run(os.getpid).values()))
    done = []

    def kill_at_first(count):
        done.append(count)
        if count == 1:
            wait_for((tmp_path / f"started-{victim}").exists)
            os.kill(victim, signal.SIGKILL)
            (tmp_path / "go").touch()

    results = run_on_cluster(cluster, weigh, [(data, number, tmp_path) for number in range(10)], kill_at_first)
    assert [weight for weight, _ in results] == [1000 * number for number in range(10)]
    assert done == list(range(1, 11))
    assert any(worker != victim for _, worker in results)
    assert psutil.Process(victim).status() == psutil.STATUS_ZOMBIE


def test_no_scheduler_is_one_line(monkeypatch):
    monkeypatch.setattr("mrd_identification.cluster.CONNECT_TIMEOUT", 0.2)
    with pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no dask scheduler answers"):
        run_on_cluster("tcp://127.0.0.1:9", weigh, [((), 1)])
    with pytest.raises(InputError, match="--scheduler nonsense:x:y: expected the address of a dask scheduler"):
        run_on_cluster("nonsense:x:y", weigh, [((), 1)])

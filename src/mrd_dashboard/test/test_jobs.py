"""Fits and diagnoses in a process of their own."""

import json
import os
import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_dashboard.apply import apply_report
from mrd_dashboard.jobs import FIT_ANYWAY, LOOK_PERIOD, Job, JobRequest, Jobs
from mrd_diagnosis.diagnose import choose_model
from mrd_identification.fit_file import read_fit
from mrd_runs import Run, read_run, read_runs
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.simulate import write_csv

# A job gives way to all other work of the machine.
pytestmark = pytest.mark.timeout(300)

QUICK = {"population": 8, "generations": 4, "seeds": 1, "profile": False}


def finish(jobs: Jobs, seconds: float = 250.0) -> Job:
    """Poll until the job has ended."""
    deadline = time.monotonic() + seconds
    while jobs.running is not None:
        jobs.poll()
        assert time.monotonic() < deadline, jobs.running
        time.sleep(0.02)
    return jobs.all[-1]


def test_a_fit_shows_its_progress_and_writes_what_the_tool_writes(tmp_path: Path, recorded: list[str]) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("identify", tuple(recorded[:2]), "bingham", held_out=(recorded[2],), method=QUICK))
    with pytest.raises(InputError, match="wait for its end or cancel it"):
        jobs.start(JobRequest("identify", tuple(recorded), "bingham"))
    job = finish(jobs)
    assert job.state == "done", job.message
    assert [share for share, _ in job.history] == sorted(share for share, _ in job.history)
    assert len(job.history) >= 2
    # The Pareto front of the last generation: what is better in one norm is worse in the other.
    e2, einf = np.array(job.front).T
    assert np.all(np.diff(e2) >= 0)
    assert np.all(np.diff(einf) <= 0)
    assert e2[0] > 0
    assert job.report.is_file()
    assert read_fit(job.folder / "fit.json").model == "bingham"


def test_a_fit_takes_the_model_that_predicts_best(tmp_path: Path, recorded: list[str]) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("identify", tuple(recorded), "auto", method=QUICK))
    job = finish(jobs)
    assert job.state == "done", job.message
    assert read_fit(job.folder / "fit.json").model == choose_model(read_runs(recorded)).id


def test_a_faulty_recording_is_not_fitted(tmp_path: Path, recorded: list[str]) -> None:
    run = read_run(recorded[0])
    faulty = str(tmp_path / "wrong_sign.csv")
    write_csv(Run("wrong_sign", run.time, run.position, run.velocity, run.current, -run.force), faulty)
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("identify", (faulty,), "bingham", method=QUICK))
    job = finish(jobs)
    assert job.state == "failed", job.message
    assert "wrong_sign" in job.message
    assert job.message.endswith(f"; or tick {FIT_ANYWAY!r}, to fit them as they are")
    assert "\n" not in job.message
    jobs.start(JobRequest("identify", (faulty,), "bingham", method=QUICK, anyway=True))
    assert finish(jobs).state == "done", jobs.all[-1].message


def test_a_diagnosis_judges_a_fit_that_there_is(tmp_path: Path, recorded: list[str], stored_fit: Path) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", tuple(recorded), "bingham", parameters=str(stored_fit)))
    job = finish(jobs)
    assert job.state == "done", job.message
    report = json.loads((job.folder / "gap_report.json").read_text())
    assert report["gap"]["as_given"] is not None


def test_earlier_reports_are_listed_again(tmp_path: Path) -> None:
    folder = tmp_path / "results" / "diagnose-20261123-120000"
    folder.mkdir(parents=True)
    (folder / "gap_report.html").touch()
    (tmp_path / "results" / "identify-20261123-120000").mkdir()  # was cancelled
    (job,) = Jobs(tmp_path / "results").all
    assert (job.request.kind, job.state, job.folder) == ("diagnose", "done", folder)


def test_many_pages_share_one_look_for_fits(tmp_path: Path) -> None:
    jobs = Jobs(tmp_path)
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "fit.json").touch()
        jobs.look_for_fits()
    assert [fit.parent.name for fit in jobs.fits()] == ["first"]
    jobs._next_look -= LOOK_PERIOD
    jobs.look_for_fits()
    assert {fit.parent.name for fit in jobs.fits()} == {"first", "second"}


def test_an_unusable_recording_fails_the_job_in_one_line(tmp_path: Path) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", (str(tmp_path / "missing.csv"),), "bingham"))
    job = finish(jobs)
    assert job.state == "failed"
    assert "missing.csv" in job.message
    assert "\n" not in job.message


def test_the_end_of_a_job_is_logged(dashboard, tmp_path: Path) -> None:
    dashboard.jobs.start(JobRequest("diagnose", (str(tmp_path / "missing.csv"),), "bingham"))
    deadline = time.monotonic() + 100.0
    while dashboard.jobs.running is not None:
        dashboard.hear_jobs()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    (entry,) = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert (entry["who"], entry["action"], entry["result"].partition(":")[0]) == ("page", "diagnose", "failed")


def test_a_job_is_cancelled_at_once(tmp_path: Path, recorded: list[str]) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", tuple(recorded), "bouc_wen"))
    begun = time.monotonic()
    jobs.cancel()
    assert time.monotonic() - begun < 10.0
    assert jobs.all[-1].state == "cancelled"
    assert jobs.running is None


def test_a_job_is_cancelled_without_waiting_for_a_process_that_cannot_be_terminated(
    tmp_path: Path, recorded: list[str]
) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", tuple(recorded), "bouc_wen"))
    process = jobs._process
    assert process is not None
    assert process.pid is not None
    # It does not react to SIGTERM any more; nor does one that inherits from a node that SIGTERM is blocked.
    os.kill(process.pid, signal.SIGSTOP)
    canceller = threading.Thread(target=jobs.cancel, daemon=True)
    canceller.start()
    canceller.join(20.0)
    waits = canceller.is_alive()
    # Whichever thread reaps the process, the other one learns of it a moment later.
    deadline = time.monotonic() + 20.0
    while process.exitcode is None and time.monotonic() < deadline:
        time.sleep(0.02)
    dead = process.exitcode is not None
    process.kill()
    assert not waits, "the page would stand still meanwhile"
    assert dead


def test_a_job_is_cancelled_without_waiting_for_the_end_of_its_process(tmp_path: Path) -> None:
    jobs, ended = Jobs(tmp_path / "results"), threading.Event()
    jobs.all.append(Job(1, JobRequest("diagnose", ("a.csv",), "bingham"), tmp_path))
    jobs._process = SimpleNamespace(kill=lambda: None, join=ended.wait)  # as one that waits for its disk
    canceller = threading.Thread(target=jobs.cancel, daemon=True)
    canceller.start()
    canceller.join(20.0)
    waits = canceller.is_alive()
    ended.set()
    assert not waits, "the page would stand still meanwhile"
    assert jobs.all[-1].state == "cancelled"


def test_a_trend_over_dates_predicts_when_the_limit_is_reached(tmp_path: Path) -> None:
    model, time = find_model("bingham"), np.arange(1500) / 250
    random = np.random.default_rng(1)
    paths = []
    for number in range(4):
        position = 9e-3 * np.sin(3.1 * time + number) + 3e-3 * np.sin(11.0 * time)
        velocity = 9e-3 * 3.1 * np.cos(3.1 * time + number) + 3e-3 * 11.0 * np.cos(11.0 * time)
        current = np.repeat(random.choice([0.0, 0.1, 0.2, 0.3], 30), 50)
        theta = model.vector({"yield_force": 20.0 + 4.0 * number, "coil_lag": 0.0})
        path = make_path(time, position, velocity, np.gradient(velocity, time), current)
        force = model.force(theta, path) + random.standard_normal(len(time))
        paths.append(str(tmp_path / f"{number}.csv"))
        write_csv(Run(str(number), time, position, velocity, current, force), paths[-1])
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("trend", tuple(paths), "bingham", follow="yield_force", limit=60.0))
    job = finish(jobs)
    assert job.state == "done", job.message
    assert "yield_force grows" in job.message
    assert "It reaches 60" in job.message
    assert "yield_force" in job.report.read_text()
    (again,) = Jobs(tmp_path / "results").all
    assert again.request.kind == "trend"


def test_a_job_whose_process_dies_has_failed(tmp_path: Path, recorded: list[str]) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", tuple(recorded), "bouc_wen"))
    assert jobs._process is not None
    jobs._process.kill()
    jobs._process.join()
    job = finish(jobs)
    assert (job.state, "memory" in job.message) == ("failed", True)


def test_nothing_is_applied_without_a_simulator(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no simulator"):
        apply_report(tmp_path / "gap_report.json", "")


def test_what_is_not_proven_is_refused_with_a_remedy_that_the_page_has(tmp_path: Path, monkeypatch) -> None:
    report = {"verdict": "ambiguous", "model": "bingham", "laws": {}, "gap": None, "runs": {"reference": []}}
    report["corrected"] = {"parameters": {}, "effects": ["coil_lag"]}
    monkeypatch.setattr("mrd_dashboard.apply.read_gap_report", lambda _: report)
    with pytest.raises(InputError, match=r"coil_lag is not proven; record the experiment that it advises$"):
        apply_report(tmp_path / "gap_report.json", "plant.yaml")


def test_a_report_that_is_none_is_refused(tmp_path: Path) -> None:
    report = tmp_path / "gap_report.json"
    report.write_text(json.dumps({"schema": "mrd-gap/0"}))
    with pytest.raises(InputError, match=r"gap_report\.json"):
        apply_report(report, "plant.yaml")

"""Fits and diagnoses in a process of their own."""

import json
import time
from pathlib import Path

import pytest

from mrd_base import InputError
from mrd_dashboard.apply import apply_report
from mrd_dashboard.jobs import Job, JobRequest, Jobs
from mrd_identification.fit_file import read_fit

QUICK = {"population": 8, "generations": 4, "seeds": 1, "profile": False}


def finish(jobs: Jobs, seconds: float = 100.0) -> Job:
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
    assert job.report.is_file()
    assert read_fit(job.folder / "fit.json").model == "bingham"


def test_earlier_reports_are_listed_again(tmp_path: Path) -> None:
    folder = tmp_path / "results" / "diagnose-20261123-120000"
    folder.mkdir(parents=True)
    (folder / "gap_report.html").touch()
    (tmp_path / "results" / "identify-20261123-120000").mkdir()  # was cancelled
    (job,) = Jobs(tmp_path / "results").all
    assert (job.request.kind, job.state, job.folder) == ("diagnose", "done", folder)


def test_an_unusable_recording_fails_the_job_in_one_line(tmp_path: Path) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", (str(tmp_path / "missing.csv"),), "bingham"))
    job = finish(jobs)
    assert job.state == "failed"
    assert "missing.csv" in job.message
    assert "\n" not in job.message


def test_a_job_is_cancelled_at_once(tmp_path: Path, recorded: list[str]) -> None:
    jobs = Jobs(tmp_path / "results")
    jobs.start(JobRequest("diagnose", tuple(recorded), "bouc_wen"))
    begun = time.monotonic()
    jobs.cancel()
    assert time.monotonic() - begun < 10.0
    assert jobs.all[-1].state == "cancelled"
    assert jobs.running is None


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


def test_a_report_that_is_none_is_refused(tmp_path: Path) -> None:
    report = tmp_path / "gap_report.json"
    report.write_text(json.dumps({"schema": "mrd-gap/0"}))
    with pytest.raises(InputError, match=r"gap_report\.json"):
        apply_report(report, "plant.yaml")

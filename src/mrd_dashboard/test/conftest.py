"""A dashboard without a bench: what it asks for is noted, and a run writes a small bag."""

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nicegui.testing import User, user_simulation

from mrd_base import InputError
from mrd_dashboard.audit import AuditLog
from mrd_dashboard.bench_diagnosis import BenchDiagnosisOutcome, BenchDiagnosisRequest
from mrd_dashboard.bench_view import BenchView
from mrd_dashboard.control_right import ControlRight
from mrd_dashboard.dashboard import Dashboard, Progress, RoundProgress, RunOutcome, Visitor
from mrd_dashboard.jobs import Jobs
from mrd_dashboard.pages.shell import page
from mrd_dashboard.recordings import Recordings
from mrd_dashboard.run_queue import Kind, RunQueue
from mrd_identification.fit_file import write_fit
from mrd_identification.identify import identify
from mrd_identification.method import Method
from mrd_runs import read_runs

EXPERIMENTS = Path(__file__).resolve().parents[3] / "config/experiments"


ANN = Visitor("a", "Ann")


class NotedCommands:
    """Notes what is asked for. ``refusal`` is the reason for which everything but the emergency stop is refused."""

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.kinds: list[Kind] = []
        self.stops: list[int] = []
        self.refusal = ""
        self.go_on = asyncio.Event()  # until then, a diagnosis on the bench records
        self.ending = "cause_known"

    def emergency_stop(self) -> None:
        self.asked.append("emergency stop")

    async def call(self, name: str) -> str:
        self.asked.append(name)
        if self.refusal:
            raise InputError(self.refusal)
        return f"{name}: done"

    async def run(self, kind: Kind, experiment: str, bag: Path, seed: int, stops: int, progress: Progress) -> RunOutcome:
        self.asked.append((experiment, bag.name, seed))
        self.kinds.append(kind)
        self.stops.append(stops)
        if self.refusal:
            raise InputError(self.refusal)
        progress("running", 1.0)
        make_bag(bag)
        return RunOutcome(True, "12 samples in 0.1 s, none lost", str(bag))

    async def diagnose(self, request: BenchDiagnosisRequest, progress: RoundProgress) -> BenchDiagnosisOutcome:
        self.asked.append(request)
        if self.refusal:
            raise InputError(self.refusal)
        progress(1, "recording large_random_current: running", 0.2, "")
        await self.go_on.wait()
        progress(2, "recording small_current: running", 0.1, "2 effects may be the cause.")
        request.folder.mkdir(parents=True, exist_ok=True)
        (request.folder / "diagnosis.html").write_text("<h1>Diagnosis on the bench</h1>")
        why = "The cause has a probability of 95 %."
        return BenchDiagnosisOutcome(True, "The force sensor lags by 2 ms.", why, self.ending)

    def cancel_diagnosis(self) -> None:
        self.asked.append("cancel the diagnosis")


def make_bag(path: Path) -> Path:
    """Make a folder that looks like a bag, whose samples cannot be read."""
    path.mkdir(parents=True)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    return path


@pytest.fixture
def commands() -> NotedCommands:
    return NotedCommands()


@pytest.fixture
def dashboard(tmp_path: Path, commands: NotedCommands) -> Iterator[Dashboard]:
    recordings = Recordings(tmp_path / "runs")
    audit = AuditLog(recordings.folder / "audit.jsonl")
    yield Dashboard(
        BenchView(),
        commands,
        recordings,
        RunQueue(recordings.folder / "queue.json"),
        Jobs(recordings.folder / "results"),
        ControlRight(),
        audit,
        EXPERIMENTS,
        EXPERIMENTS.parent / "control/hybrid_test.yaml",
    )
    audit.close()


@pytest.fixture
def stored_fit(dashboard: Dashboard, recorded: list[str]) -> Path:
    """File of a fit among the results."""
    quick = Method(population=8, generations=4, seeds=1, profile=False)
    folder = dashboard.jobs.folder / "identify-1"
    folder.mkdir(parents=True)
    write_fit(identify(read_runs(recorded[:1]), "bingham", method=quick), folder)
    return folder / "fit.json"


@pytest.fixture
def new_bag() -> Callable[[Path], Path]:
    return make_bag


@pytest.fixture
def visit(dashboard: Dashboard) -> Callable[[Callable[[User], Awaitable[None]]], None]:
    """Open the page as Ann, and do what the test wants."""

    def run(work: Callable[[User], Awaitable[None]]) -> None:
        async def simulate() -> None:
            async with user_simulation(root=lambda: page(dashboard, ANN)) as user:
                await user.open("/")
                await work(user)

        asyncio.run(simulate())

    return run

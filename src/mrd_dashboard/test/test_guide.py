"""The guide from recordings to the cause of a gap."""

import asyncio
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process import run_mrd
from nicegui.testing import User

from mrd_base import InputError
from mrd_dashboard.guide import AS_GOOD, STEPS, Guide, Outcome, check_data, damper_to_validate, hold_back, judge_prediction
from mrd_dashboard.guide_steps import check_recordings, start_step
from mrd_dashboard.import_files import import_files
from mrd_dashboard.jobs import Job, JobRequest
from mrd_dashboard.recordings import Notes
from mrd_runs import Run, read_run, read_runs
from mrd_sim.simulate import write_csv

WORN = sorted((Path(__file__).resolve().parents[3] / "examples/worn_joint").glob("*.csv"))


@given(taken=st.lists(st.tuples(st.sampled_from(STEPS), st.booleans()), max_size=12))
def test_a_step_is_open_exactly_while_all_before_it_have_passed(taken) -> None:
    guide = Guide()
    for step, passed in taken:
        if not guide.is_open(step):
            with pytest.raises(InputError, match="take that one first"):
                guide.require_open(step)
            continue
        guide.end(step, Outcome(passed, "found"))
        assert all(later not in guide.outcomes for later in STEPS[STEPS.index(step) + 1 :])
    passed = [step for step in STEPS if step in guide.outcomes and guide.outcomes[step].passed]
    assert passed == list(STEPS[: len(passed)])
    assert [guide.is_open(step) for step in STEPS] == [number <= len(passed) for number in range(len(STEPS))]


def test_the_guide_outlives_the_page(tmp_path: Path) -> None:
    file = tmp_path / "guide.json"
    guide = Guide(file)
    guide.choose(["a", "b"])
    guide.end("check", Outcome(True, "nothing"))
    guide.begin("fit", "identify-1")
    again = Guide(file)
    assert again == guide
    again.hear([])  # the job has ended with the page
    assert again.under_way is None
    assert "started again" in again.outcomes["fit"].sentence
    file.write_text("{")
    assert Guide(file).outcomes == {}


def test_other_recordings_close_the_later_steps(tmp_path: Path) -> None:
    guide = Guide()
    guide.choose(["a", "b", "c"])
    guide.end("check", Outcome(True, "nothing"))
    guide.begin("fit", "identify-1")
    job = Job(1, JobRequest("identify", ("a",), "bingham"), tmp_path / "identify-1", "cancelled", message="cancelled")
    guide.hear([job])
    assert guide.outcomes["fit"] == Outcome(False, "cancelled", "identify-1")
    guide.choose(["a"])
    assert list(guide.outcomes) == ["data"]
    assert guide.outcomes["data"].sentence == "1 recording is chosen: a."


def test_the_worst_finding_is_told_with_its_remedy(tmp_path: Path) -> None:
    run = read_run(WORN[0])
    faulty = tmp_path / "wrong_sign.csv"
    write_csv(Run("wrong_sign", run.time, run.position, run.velocity, run.current, -run.force), str(faulty))
    found = check_data([str(faulty), str(WORN[1])])
    assert not found.passed
    assert found.sentence.startswith("The worst finding is a fault: wrong_sign")
    good = check_data([str(file) for file in WORN])
    assert good.passed
    assert good.sentence == "The data check finds nothing wrong in 4 recordings."
    assert (
        good.held_back_sentence == f"{WORN[good.held_back].stem} is held back: it is not fitted, but predicted at the end."
    )


def test_what_is_held_back_lies_within_the_others() -> None:
    runs = read_runs([str(file) for file in WORN])
    place, _ = hold_back(runs)
    others = [np.ptp(run.position) for run in runs if run is not runs[place]]
    assert np.ptp(runs[place].position) < max(others)
    beyond = [run for run in runs if run.name != "3_current_steps"]  # each in another way
    assert hold_back(beyond)[0] is None
    assert "goes beyond the others" in hold_back(beyond)[1]
    assert hold_back(runs[:2])[0] is None
    assert "record one more run" in hold_back(runs[:2])[1]


def report(folder: Path, *, effects: list[str], verdict: str = "explained") -> None:
    """Change the verdict of a real gap report, of which there is one in the folder."""
    file = folder / "gap_report.json"
    content = json.loads(file.read_text())
    content["verdict"] = verdict
    content["corrected"]["effects"] = effects
    file.write_text(json.dumps(content))


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the diagnosis of the worn joint with few candidates, as the tool writes it."""
    folder = tmp_path_factory.mktemp("diagnosed")
    options = ["--model", "bouc_wen", "--effects", "joint_play,seal_friction", "--output", folder]
    run_mrd("diagnose", *WORN, *options).check_returncode()
    return folder


@pytest.mark.timeout(300)
def test_what_is_validated_is_what_the_diagnosis_proves(diagnosed: Path, tmp_path: Path) -> None:
    assert damper_to_validate(tmp_path, diagnosed) == diagnosed / "gap_report.json"
    unproven = shutil.copytree(diagnosed, tmp_path / "unproven")
    report(unproven, effects=[], verdict="unknown_effect")
    assert damper_to_validate(tmp_path, unproven) == tmp_path / "fit.json"


@pytest.mark.timeout(300)
def test_a_prediction_is_judged_by_noise_and_by_what_was_left_out(diagnosed: Path, tmp_path: Path) -> None:
    after = json.loads((diagnosed / "gap_report.json").read_text())["gap"]["after"]["value"]

    def judged(error: float | None, floor: float, effects: tuple[str, ...] = ("joint_play",)) -> tuple[bool, str]:
        content = {"model": "bouc_wen", "effects": effects, "nrmse": error, "noise_floor": floor, "runs": [{"name": "new"}]}
        (tmp_path / "validation.json").write_text(json.dumps(content))
        return judge_prediction(tmp_path, diagnosed, "It is said.")

    passed, sentence = judged(0.99 * AS_GOOD * after, 0.01 * after)
    assert passed
    assert sentence.startswith("The simulator corrected by joint_play predicts new: the error is ")
    passed, sentence = judged(1.01 * AS_GOOD * after, 0.01 * after)
    assert not passed
    assert "does not predict new" in sentence
    assert judged(10 * after, 9 * after) == (True, judged(10 * after, 9 * after)[1])
    assert "hardly more than noise" in judged(10 * after, 9 * after)[1]
    assert judged(after, 0.0, ())[1].startswith("The fitted bouc_wen predicts new")
    assert judged(None, 0.0)[0] is False


def import_worn(dashboard) -> list[str]:
    return import_files(WORN, dashboard.recordings.folder)


def test_files_are_imported_all_or_none(dashboard, tmp_path: Path) -> None:
    assert import_worn(dashboard) == [file.stem for file in WORN]
    text = tmp_path / "notes.csv"
    text.write_text("a,b\nhello,world\n")
    with pytest.raises(InputError, match=r"^notes\.csv") as caught:
        import_files([text], dashboard.recordings.folder)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) not in str(caught.value)


def test_recordings_are_checked_and_the_steps_start_the_jobs_of_the_other_tabs(dashboard, monkeypatch) -> None:
    names = import_worn(dashboard)
    # Notes that are written later, as on the first recording here, change its folder, but not when it was recorded.
    dashboard.recordings.write_notes(names[0], Notes(text="as new"))
    asked: list[JobRequest] = []

    def start(request: JobRequest) -> Job:
        asked.append(request)
        return Job(len(asked), request, dashboard.jobs.folder / f"{request.kind}-{len(asked)}")

    monkeypatch.setattr(dashboard.jobs, "start", start)
    with pytest.raises(InputError, match="no recordings are chosen"):
        asyncio.run(check_recordings(dashboard, []))
    with pytest.raises(InputError, match="take that one first"):
        start_step(dashboard, "fit", model="auto")
    asyncio.run(check_recordings(dashboard, names[::-1]))
    guide = dashboard.guide
    assert guide.runs == tuple(names)
    (held_back,) = guide.held_back
    start_step(dashboard, "fit", model="auto")
    (request,) = asked
    assert (request.kind, request.model, len(request.runs)) == ("identify", "auto", len(names) - 1)
    assert [Path(run).name for run in request.runs] == [name for name in names if name != held_back]
    with pytest.raises(InputError, match="wait for its end or cancel it"):
        asyncio.run(check_recordings(dashboard, names))


def test_a_recording_that_cannot_be_read_fails_the_check(dashboard, new_bag) -> None:
    new_bag(dashboard.recordings.folder / "broken")
    with pytest.raises(InputError):
        asyncio.run(check_recordings(dashboard, ["broken"]))
    assert dashboard.guide.outcomes["data"].passed
    assert not dashboard.guide.outcomes["check"].passed


@pytest.mark.timeout(300)
def test_what_was_fitted_is_no_validation(dashboard, stored_fit, diagnosed: Path) -> None:
    names = import_worn(dashboard)
    asyncio.run(check_recordings(dashboard, names))
    guide = dashboard.guide
    guide.end("fit", Outcome(True, "fitted", stored_fit.parent.name))
    shutil.copytree(diagnosed, dashboard.jobs.folder / "diagnose-1")
    guide.end("diagnose", Outcome(True, "explained", "diagnose-1"))
    with pytest.raises(InputError, match="was fitted"):
        start_step(dashboard, "validate", predicted=[guide.fitted[0]])
    with pytest.raises(InputError, match="record one more run"):
        start_step(dashboard, "validate", predicted=[])
    start_step(dashboard, "validate", predicted=list(guide.held_back))
    assert guide.under_way is not None
    while dashboard.jobs.running:
        dashboard.hear_jobs()
    dashboard.hear_jobs()
    outcome = guide.outcomes["validate"]
    assert outcome.passed, outcome
    assert outcome.sentence.startswith(f"The simulator corrected by joint_play predicts {guide.held_back[0]}")
    assert Guide(guide.file).outcomes == ({} if guide.file is None else guide.outcomes)


def test_the_page_leads_by_one_sentence_and_one_button(visit, dashboard) -> None:
    names = import_worn(dashboard)

    async def work(user: User) -> None:
        (field,) = user.find(marker="guide-runs").elements
        field.value = names
        user.find(marker="next-Check").click()
        await user.should_see("press Take control first")
        assert dashboard.guide.outcomes == {}
        user.find("Take control").click()
        user.find(marker="next-Check").click()
        await user.should_see("finds nothing wrong in 4 recordings", retries=300)
        await user.should_see("It opens when Fit has passed.")

    visit(work)
    assert dashboard.control.holds("a")


def test_a_set_that_the_guide_has_queued_is_chosen_once_it_is_recorded(visit, dashboard, monkeypatch) -> None:
    names = import_worn(dashboard)

    async def queue_set(*_: object) -> str:
        for name in names:
            dashboard.queue.add(name, "", 1.0, batch="characterise-1")
        return "queued"

    monkeypatch.setattr(dashboard, "queue_set", queue_set)

    async def work(user: User) -> None:
        user.find("Take control").click()
        user.find("No recordings yet?").click()
        user.find(marker="record-set").click()
        await user.should_see("queued")
        (field,) = user.find(marker="guide-runs").elements
        for run in list(dashboard.queue.runs):
            assert field.value == []
            dashboard.queue.end(run.number, "done", "", str(dashboard.recordings.folder / run.name))
        async with asyncio.timeout(30):
            while field.value != names:
                await asyncio.sleep(0.1)

    visit(work)


def test_the_advised_experiment_is_recorded_and_joins_the_others(visit, dashboard) -> None:
    *first, last = import_worn(dashboard)
    guide = dashboard.guide
    guide.choose(first)
    for step in ("check", "fit"):
        guide.end(step, Outcome(True, "found"))
    guide.end("diagnose", Outcome(True, "It is unclear.", "diagnose-1"))
    folder = dashboard.jobs.folder / "diagnose-1"
    folder.mkdir(parents=True)
    dashboard.jobs.all.append(Job(1, JobRequest("diagnose", (), "bingham"), folder, "done"))
    dashboard.queue.paused = True

    async def work(user: User) -> None:
        user.find("Take control").click()
        await user.should_see(marker="next-Validate", retries=30)
        await user.should_not_see(marker="guide-advised")
        shutil.copy(dashboard.experiments / "paper.yaml", folder / "next_experiment.yaml")
        await user.should_see(marker="guide-advised", retries=30)
        user.find(marker="guide-advised").click()
        await user.should_see("advised experiment: 1 run waits in the queue", retries=100)
        (run,) = dashboard.queue.runs
        dashboard.queue.end(run.number, "done", "", str(dashboard.recordings.folder / last))
        (field,) = user.find(marker="guide-runs").elements
        async with asyncio.timeout(30):
            while field.value != [*first, last]:
                await asyncio.sleep(0.1)

    visit(work)

"""Recordings, the form of an experiment, the queue, and what the page does with them."""

import asyncio
import json
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import psutil
import pytest

from mrd_base import InputError
from mrd_dashboard.bench_view import NODE_SILENT_AFTER, NodeHealth
from mrd_dashboard.dashboard import REPORTS_FOLDER, RunOutcome, Visitor, run_next
from mrd_dashboard.experiment_form import (
    find_experiments,
    find_sets,
    form_of,
    form_text,
    preview,
    preview_set,
    waveform_fields,
)
from mrd_dashboard.import_files import import_files
from mrd_dashboard.look import Look, cached_look, keep_look, look_at
from mrd_dashboard.recordings import Notes, Recordings, make_notes, notes_form
from mrd_dashboard.run_queue import RunQueue
from mrd_dashboard.workers import Workers
from mrd_runs.bag import BagWriter
from mrd_trajectory.experiment import parse_experiment, read_experiment
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.steps import is_damper_test
from mrd_trajectory.waveforms import CHANNEL_UNITS, WAVEFORMS

WORN = Path(__file__).resolve().parents[3] / "examples/worn_joint"
ANN, BOB = Visitor("a", "Ann"), Visitor("b", "Bob")
SINE = """
name: sine
duration_s: 5
rate_hz: 500
rod: {waveform: sine, amplitude_mm: 8, frequency_hz: 1}
coil: {waveform: constant, level_mA: 100}
"""


# Recordings


def test_recordings_are_found_with_their_notes(dashboard, new_bag) -> None:
    recordings = dashboard.recordings
    for number, name in enumerate(("sine-1", "set/a", "set/b")):
        new_bag(recordings.folder / name)
        os.utime(recordings.folder / name, (1e9 + number, 1e9 + number))
    (recordings.folder / "set/notes").mkdir()
    recordings.write_notes("set/a", Notes(damper="RD-17", temperature=31.5, tags=("hot", "worn"), text="Rückseite schabt"))
    assert [recording.id for recording in recordings.search()] == ["set/b", "set/a", "sine-1"]
    assert [recording.id for recording in recordings.search("rd-17 HOT")] == ["set/a"]
    assert recordings.search("cold") == []
    assert recordings.find("set/a").notes.temperature == 31.5


def test_the_recordings_of_a_diagnosis_are_listed_found_and_looked_at(dashboard, new_bag) -> None:
    folder = dashboard.recordings.folder / "diagnosis-20260101-120000"
    by_hand = new_bag(folder / "by_hand/measurement_1")
    recorded = new_bag(folder / "round_1/large_random_current")
    killed = folder / "round_2/small_current"
    killed.mkdir(parents=True)
    (killed / "small_current_0.mcap").touch()
    new_bag(folder / "round_2/incomplete/small_current")
    listed = {one.path: one for one in dashboard.recordings.search()}
    assert listed.keys() == {by_hand, recorded, killed}
    assert all(dashboard.recordings.find(one.id) == one for one in listed.values())
    assert not listed[killed].closed
    asyncio.run(dashboard.look(listed[recorded]))
    assert dashboard.known_look(listed[recorded]) is not None


@pytest.mark.parametrize("name", ["a/b/../c", "a/./b", "/a/b", "a//b", "a/.b/c", "a/b/c/d"])
def test_a_path_that_leads_elsewhere_is_no_recording(dashboard, new_bag, name: str) -> None:
    new_bag(dashboard.recordings.folder / "a/b/c/d")
    with pytest.raises(InputError, match="no recording"):
        dashboard.recordings.find(name)


def test_notes_are_kept_in_the_folder_of_the_recording(dashboard, new_bag) -> None:
    path = new_bag(dashboard.recordings.folder / "sine-1")
    notes = Notes(text="<script>alert(1)</script>: 'x'\nsecond line", tags=("a", "b"))
    dashboard.recordings.write_notes("sine-1", notes)
    path.rename(dashboard.recordings.folder / "moved")
    assert dashboard.recordings.find("moved").notes == notes


def test_the_form_of_notes_reads_what_it_shows() -> None:
    notes = Notes("RD-17", 22.0, ("a", "b"), "text")
    assert make_notes(notes_form(notes)) == notes
    assert make_notes(notes_form(Notes())) == Notes()
    with pytest.raises(InputError, match="temperature_degC"):
        make_notes({"temperature_degC": 900.0})


@pytest.mark.parametrize("content", ["damper: [unclosed\n", "serial: RD-17\n", "- a\n", "\xff"])
def test_notes_that_cannot_be_read_hide_no_recording_and_are_not_written_over(dashboard, new_bag, content: str) -> None:
    file = new_bag(dashboard.recordings.folder / "sine-1") / "notes.yaml"
    file.write_bytes(content.encode("latin-1"))
    (found,) = dashboard.recordings.search()
    assert str(file) in found.problem
    with pytest.raises(InputError, match=r"notes\.yaml.*mend or remove the file") as refused:
        dashboard.recordings.write_notes("sine-1", Notes(text="x"))
    assert "\n" not in str(refused.value)
    assert file.read_bytes() == content.encode("latin-1")
    file.unlink()
    dashboard.recordings.write_notes("sine-1", Notes(text="x"))
    assert dashboard.recordings.find("sine-1").notes.text == "x"


def test_a_link_is_no_recording(dashboard, new_bag, tmp_path: Path) -> None:
    new_bag(tmp_path / "elsewhere")
    (dashboard.recordings.folder / "link").symlink_to(tmp_path / "elsewhere")
    assert dashboard.recordings.search() == []
    with pytest.raises(InputError, match="no recording"):
        dashboard.recordings.find("link")


@pytest.mark.parametrize("name", ["../x", "a/b", "", "x" * 65, "a b", ".", "a\n"])
def test_the_name_of_a_run_is_the_name_of_one_folder(dashboard, name: str) -> None:
    with pytest.raises(InputError, match="name"):
        dashboard.recordings.new_folder(name)


def test_a_new_recording_has_a_folder_of_its_own(dashboard, new_bag) -> None:
    first = new_bag(dashboard.recordings.new_folder("sine"))
    assert dashboard.recordings.new_folder("sine") != first


def test_ten_thousand_recordings_are_listed_within_seconds(dashboard) -> None:
    for number in range(10_000):
        path = dashboard.recordings.folder / f"run-{number}"
        path.mkdir()
        (path / "metadata.yaml").touch()
    begun = time.process_time()
    assert len(dashboard.recordings.search()) == 10_000
    assert len(dashboard.recordings.search("run-77 ")) == 111
    assert time.process_time() - begun < 10.0


def test_many_pages_share_one_scan(dashboard, new_bag, monkeypatch) -> None:
    new_bag(dashboard.recordings.folder / "first")
    scans = []
    scan = Recordings._scan
    monkeypatch.setattr(Recordings, "_scan", lambda *arguments: scans.append(arguments) or scan(*arguments))
    for search in ("", "fir", "", "sec"):
        dashboard.recordings.search(search)
    assert len(scans) == 1
    new_bag(dashboard.recordings.folder / "second")
    dashboard.recordings.write_notes("first", Notes(text="x"))
    assert len(dashboard.recordings.search()) == 2, "what the page itself changes is seen at once"


def test_what_a_killed_recorder_leaves_is_listed_and_recovered(dashboard) -> None:
    path = dashboard.recordings.folder / "set/killed"
    path.parent.mkdir()
    writer = BagWriter(path)
    writer.add_topic("samples", "mrd_interfaces/msg/BenchSamples")
    block = writer.types.types["mrd_interfaces/msg/BenchSamples"]
    stamp = writer.types.types["builtin_interfaces/msg/Time"](0, 0)
    header, empty = writer.types.types["std_msgs/msg/Header"](stamp, ""), np.zeros(4)
    writer.write_message("samples", 0, block(header, 1e-3, 0, empty, empty, empty, empty, empty[:0]))
    writer.flush()
    (found,) = dashboard.recordings.search()
    assert (found.id, found.closed) == ("set/killed", False)
    dashboard.queue.start(dashboard.queue.add("sine", SINE, 5.0).number, path)
    with pytest.raises(InputError, match="is being recorded"):
        dashboard.recover("set/killed")
    dashboard.queue.end(1, "failed", "", "")
    assert "recovered 1 messages" in dashboard.recover("set/killed")
    assert {(found.id, found.closed) for found in dashboard.recordings.search()} == {
        ("set/killed", False),
        ("set/killed_recovered", True),
    }
    writer.close()


def test_a_recording_is_deleted_with_what_is_known_of_it(dashboard, new_bag) -> None:
    path = new_bag(dashboard.recordings.folder / "set/a")
    asyncio.run(dashboard.look(dashboard.recordings.find("set/a")))
    assert list(dashboard.recordings.folder.glob(".page/*.json"))
    dashboard.delete("set/a")
    assert not path.exists()
    assert not list(dashboard.recordings.folder.glob(".page/*.json"))
    with pytest.raises(InputError, match="no recording"):
        dashboard.delete("set/a")


def test_what_is_being_recorded_is_not_deleted(dashboard, new_bag) -> None:
    path = new_bag(dashboard.recordings.folder / "sine-1")
    dashboard.queue.start(dashboard.queue.add("sine", SINE, 5.0).number, path)
    with pytest.raises(InputError, match="stop the run"):
        dashboard.delete("sine-1")
    assert path.exists()


@pytest.mark.parametrize("state", ["recording", "stopping"])
def test_what_the_recorder_writes_is_neither_deleted_nor_recovered(dashboard, new_bag, state: str) -> None:
    path = new_bag(dashboard.recordings.folder / "sine-1")
    dashboard.bench.hear_recorder(state, "", str(path))
    for act in (dashboard.delete, dashboard.recover):
        with pytest.raises(InputError, match="sine-1: is being recorded"):
            act("sine-1")
    assert path.exists()
    dashboard.bench.hear_recorder("idle", "", "")
    dashboard.delete("sine-1")
    assert not path.exists()


def test_what_a_recorder_that_has_died_was_writing_may_be_deleted(dashboard, new_bag) -> None:
    path = new_bag(dashboard.recordings.folder / "sine-1")
    dashboard.bench.hear_recorder("recording", "", str(path))
    dashboard.bench._heard["recorder"] -= NODE_SILENT_AFTER + 1.0
    dashboard.bench.hear_node("recorder", NodeHealth(0, "ok"))
    with pytest.raises(InputError, match="is being recorded"):
        dashboard.delete("sine-1")  # its bench time stands still, but the node lives
    dashboard.bench._heard["node recorder"] -= NODE_SILENT_AFTER + 1.0
    dashboard.delete("sine-1")
    assert not path.exists()


# A look at a recording


def test_a_look_finds_facts_and_faults(recorded: list[str]) -> None:
    look = look_at(recorded[0])
    assert look.duration == pytest.approx(5.996)
    assert look.rate == pytest.approx(250)
    assert look.picture.count(",") > 100
    assert not look.problem


def test_a_look_at_what_is_no_recording_says_so(new_bag, tmp_path: Path) -> None:
    assert look_at(str(new_bag(tmp_path / "x"))).problem


def test_a_look_is_kept_until_the_recording_changes(new_bag, tmp_path: Path) -> None:
    bag, cache = new_bag(tmp_path / "x"), tmp_path / "cache.json"
    (bag / "x.mcap").write_text("1")
    look = Look(duration=1.5, findings=(("fault", "the clock stands"),))
    keep_look(look, bag, cache)
    assert cached_look(bag, cache) == look
    assert look.verdict == "fault"
    (bag / "x.mcap").write_text("12")
    assert cached_look(bag, cache) is None
    cache.write_text("no JSON")
    assert cached_look(bag, cache) is None


def test_the_look_at_an_open_recording_is_not_kept(dashboard) -> None:
    path = dashboard.recordings.folder / "sine-1"
    path.mkdir()
    (path / "sine-1_0.mcap").write_text("1")
    assert asyncio.run(dashboard.look(dashboard.recordings.find("sine-1"))).problem
    assert dashboard.known_look(dashboard.recordings.find("sine-1")) is None
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    asyncio.run(dashboard.look(dashboard.recordings.find("sine-1")))
    assert dashboard.known_look(dashboard.recordings.find("sine-1")) is not None


# The form


@pytest.mark.parametrize("waveform", WAVEFORMS)
@pytest.mark.parametrize("channel", CHANNEL_UNITS)
def test_every_waveform_has_a_form(channel: str, waveform: str) -> None:
    fields = waveform_fields(channel, waveform)
    assert fields
    assert all(field.key and field.doc for field in fields)


def test_every_shipped_experiment_passes_through_the_form(dashboard) -> None:
    experiments = find_experiments(dashboard.experiments)
    assert len(experiments) > 10
    for experiment in (read_experiment(file) for file in experiments.values() if not is_damper_test(file)):
        assert parse_experiment(form_text(form_of(experiment)), "form") == experiment


def test_damper_tests_are_sets_of_experiments(dashboard, tmp_path) -> None:
    sets = find_sets(find_experiments(dashboard.experiments))
    assert len(sets["acceptance"]) == 5
    sweep = preview_set(sets["acceptance/04_speed_sweep"], GeneratorSettings())
    assert [one.experiment.name for one in sweep] == [f"04_speed_sweep_{number}" for number in range(1, 6)]
    (warm_up,) = preview_set(sets["acceptance/01_warm_up"], GeneratorSettings())
    assert "until" in warm_up.text
    wear = tmp_path / "wear.yaml"
    wear.write_text("{name: wear, test: endurance, cycles: 4, every: 2, stop_when: {peak_force_percent: 5}}")
    with pytest.raises(InputError, match=r"wear\.yaml: stop_when ends a set that the tool bench runs"):
        preview_set([wear], GeneratorSettings())


def test_an_experiment_with_a_condition_passes_through_the_form() -> None:
    text = f"{SINE.rstrip()}\nrepeats: 9\nuntil: {{settled_percent: 2.5}}\n"
    experiment = parse_experiment(text, "form")
    assert parse_experiment(form_text(form_of(experiment)), "form") == experiment


def test_a_preview_shows_peaks_and_curves() -> None:
    found = preview(SINE, GeneratorSettings())
    assert found.duration > 5.0
    assert max(found.curves["position_mm"]) == pytest.approx(8.0, abs=0.1)
    assert all(peak.value <= peak.limit for peak in found.peaks if peak.quantity != "least current")


@pytest.mark.parametrize(
    ("change", "found"),
    [(("8,", "80,"), "exceeds ±26 mm"), (("sine,", "sin,"), "unknown waveform sin"), (("8,", "eight,"), "amplitude_mm")],
)
def test_a_preview_refuses_in_one_line(change: tuple[str, str], found: str) -> None:
    with pytest.raises(InputError, match=found) as caught:
        preview(SINE.replace(*change), GeneratorSettings())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("waveform", "entries"),
    [
        ("ladder", {"amplitude_mm": "5", "slopes_mm_per_s": "5", "hold_s": "1"}),
        ("staircase", {"levels_mm": "5", "hold_s": "1"}),
    ],
)
def test_a_list_of_one_value_needs_no_comma(dashboard, waveform: str, entries: dict[str, str]) -> None:
    form = form_of(parse_experiment(SINE, "form"))
    known = {field.key: field.default for field in waveform_fields("rod", waveform)}
    assert entries.keys() <= known.keys(), known
    form["rod"] = {"waveform": waveform, **entries}
    experiment = parse_experiment(form_text(form), "form")
    assert parse_experiment(form_text(form_of(experiment)), "form") == experiment


# The queue


def test_runs_are_recorded_in_their_order(dashboard, commands) -> None:
    for name in ("first", "second"):
        dashboard.queue.add(name, SINE.replace("sine\n", f"{name}\n"), 5.0)
    assert dashboard.queue.time_left > 10.0
    asyncio.run(_work_off(dashboard))
    assert [bag.partition("-")[0] for _, bag, _ in commands.asked] == ["first", "second"]
    assert [run.state for run in dashboard.queue.runs] == ["done", "done"]
    assert dashboard.queue.time_left == 0.0
    # The data check came by itself.
    assert len(dashboard.looks) == 2


def test_the_serial_number_of_a_run_goes_into_the_notes_of_its_recording(dashboard) -> None:
    run = dashboard.queue.add("sine", SINE, 5.0, damper="SN-1")
    asyncio.run(_work_off(dashboard))
    assert [recording.notes.damper for recording in dashboard.recordings.search()] == ["SN-1"]
    assert dashboard.queue.retry(run.number).damper == "SN-1"
    assert [again.damper for again in RunQueue(dashboard.queue.file).runs] == ["SN-1", "SN-1"]


def test_a_set_that_tests_a_damper_ends_with_the_reports_of_the_tool(dashboard, commands, tmp_path, monkeypatch) -> None:
    """As `bench` writes them: characterisation and sheet, found by the serial number."""
    names = ("2_slow_stroke", "4_fast_sine")
    import_files([WORN / f"{name}.csv" for name in names], tmp_path / "imported")
    succeeds = iter((True, False, True))

    async def run(_kind, experiment: str, bag: Path, _seed, _stops, _progress) -> RunOutcome:
        if not next(succeeds):
            return RunOutcome(False, "the force was too large", "")
        shutil.copytree(tmp_path / "imported" / experiment.removeprefix("name: "), bag)
        return RunOutcome(True, "recorded", str(bag))

    monkeypatch.setattr(commands, "run", run)
    batch = dashboard.queue.new_batch("speed_sweep")
    for name in names:
        dashboard.queue.add(name, f"name: {name}", 5.0, damper="SN-1", batch=batch, tests_damper=True)
    asyncio.run(_work_off(dashboard))
    reports = dashboard.recordings.folder / REPORTS_FOLDER / batch
    assert not reports.exists()  # one of its runs has failed
    dashboard.queue.retry(dashboard.queue.runs[-1].number)
    asyncio.run(_work_off(dashboard))
    assert reports.is_dir(), [(run.state, run.message) for run in dashboard.queue.runs]
    assert {"characterisation.json", "characterisation.html", "sheet.html"} <= {file.name for file in reports.iterdir()}
    assert dashboard.queue.runs[-1].message.endswith("The reports are under Dampers.")
    asyncio.run(dashboard.dampers.look(dashboard.compute))
    (damper,) = dashboard.dampers.dampers(dashboard.recordings.search())
    assert (damper.serial, len(damper.tests)) == ("SN-1", 1)


def test_a_set_without_anything_to_tell_says_so(dashboard, commands) -> None:
    batch = dashboard.queue.new_batch("empty")
    dashboard.queue.add("sine", SINE, 5.0, batch=batch, tests_damper=True)
    asyncio.run(_work_off(dashboard))
    assert "no reports: " in dashboard.queue.runs[-1].message


def test_the_queue_says_what_it_waits_for(tmp_path: Path) -> None:
    queue = RunQueue()
    assert queue.sentence() == "queue empty"
    queue.stop()
    assert queue.sentence() == "queue paused after a stop: nothing waits"
    first, second = queue.add("first", SINE, 5.0), queue.add("second", SINE, 5.0)
    assert queue.sentence() == "queue paused after a stop: 2 waiting, next is first"
    queue.paused = False
    queue.start(first.number, tmp_path)
    assert queue.sentence() == "queue: first runs, 1 waiting, next is second, about 20 s left"
    queue.end(first.number, "failed", "no space", "")
    assert queue.sentence() == f"queue paused after run {first.number}, first, has failed: 1 waiting, next is second"
    queue.remove(second.number)
    queue.paused = False
    assert queue.sentence() == "queue empty"


def test_the_runs_of_a_set_stay_in_the_queue_until_it_has_ended(tmp_path: Path) -> None:
    queue = RunQueue()
    runs = [queue.add(f"run{number}", SINE, 1.0, batch="long-1", tests_damper=True) for number in range(120)]
    for run in runs:
        assert queue.recorded_set("long-1") == []
        queue.start(run.number, tmp_path)
        last = run is runs[-1]
        if last:
            assert len(queue.runs) == len(runs)
        queue.end(run.number, "done", "", "bag")
        if last:
            assert len(queue.recorded_set("long-1")) == len(runs)


async def _work_off(dashboard) -> None:
    while await run_next(dashboard):
        pass
    await asyncio.gather(*dashboard.tasks)


@pytest.mark.parametrize("error", [BrokenProcessPool("a worker died"), RuntimeError("no context"), OSError(28, "No space")])
def test_an_error_of_any_kind_ends_the_run_and_not_the_queue(dashboard, commands, error: Exception) -> None:
    async def fail(*_):
        raise error

    run, commands.run = commands.run, fail
    dashboard.queue.add("sine", SINE, 5.0)
    asyncio.run(_work_off(dashboard))
    (ended,) = dashboard.queue.runs
    assert ended.state == "failed"
    assert str(error) in ended.message
    commands.run = run
    dashboard.queue.retry(1)
    asyncio.run(_work_off(dashboard))
    assert [run.state for run in dashboard.queue.runs] == ["failed", "done"]


def test_a_run_whose_name_is_no_folder_fails(dashboard) -> None:
    dashboard.queue.add("../sine", SINE, 5.0)
    asyncio.run(_work_off(dashboard))
    assert dashboard.queue.runs[0].state == "failed"
    assert "letters" in dashboard.queue.runs[0].message


def test_a_queue_that_cannot_be_kept_still_works_and_says_so(dashboard) -> None:
    dashboard.queue.file = dashboard.recordings.folder / "missing" / "queue.json"
    dashboard.queue.add("sine", SINE, 5.0)
    asyncio.run(_work_off(dashboard))
    assert dashboard.queue.runs[0].state == "done"
    assert "queue will be lost" in dashboard.problem
    dashboard.queue.file.parent.mkdir()
    dashboard.queue.add("sine", SINE, 5.0)
    assert dashboard.problem == ""


def test_the_next_run_does_not_wait_for_the_data_check(dashboard) -> None:
    async def work() -> None:
        waiting = asyncio.Event()

        async def slow(*_) -> None:
            await waiting.wait()

        dashboard.look = slow
        for _ in range(2):
            dashboard.queue.add("sine", SINE, 5.0)
        async with asyncio.timeout(20):
            assert await run_next(dashboard)
            assert await run_next(dashboard)
        waiting.set()
        await asyncio.gather(*dashboard.tasks)

    asyncio.run(work())
    assert [run.state for run in dashboard.queue.runs] == ["done", "done"]


def test_news_of_a_run_that_has_ended_change_nothing(tmp_path: Path) -> None:
    queue = RunQueue()
    run = queue.add("sine", SINE, 5.0)
    queue.start(run.number, tmp_path)
    queue.progress(run.number, "running", 1.0)
    queue.end(run.number, "done", "12 samples", "")
    queue.progress(run.number, "running", 2.0)
    assert (queue.runs[0].state, queue.runs[0].phase, queue.runs[0].elapsed) == ("done", "", 1.0)


def test_workers_leave_blocked_the_signals_that_end_a_node() -> None:
    # In a fresh process: multiprocessing unblocks them with its first pool only.
    script = (
        "import signal; from mrd_dashboard.workers import Workers\n"
        "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT}); Workers().close()\n"
        "print(sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "SIGTERM" in done.stdout
    assert "SIGINT" in done.stdout


def test_workers_end_when_the_page_is_killed() -> None:
    script = (
        "import asyncio, os, signal\nfrom mrd_dashboard.workers import Workers\n"
        "async def work():\n    workers = Workers()\n    print(await workers.run(os.getpid), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
        "asyncio.run(work())\n"
    )
    done = subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, timeout=60)
    worker, deadline = int(done.stdout), time.monotonic() + 60
    while psutil.pid_exists(worker) and psutil.Process(worker).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_workers_are_started_again_when_one_has_died() -> None:
    async def work() -> None:
        workers = Workers()
        try:
            with pytest.raises(InputError, match="has died"):
                await workers.run(os._exit, 1)
            assert await workers.run(abs, -3) == 3
            with pytest.raises(ValueError, match="invalid literal"):
                await workers.run(int, "x")
        finally:
            workers.close()

    asyncio.run(work())


def test_after_a_refusal_the_other_runs_wait(dashboard, commands) -> None:
    commands.refusal = "the bench is in mode fault (interlock force); remove the cause, then call reset_fault"
    for _ in range(2):
        dashboard.queue.add("sine", SINE, 5.0)
    assert asyncio.run(run_next(dashboard))
    assert not asyncio.run(run_next(dashboard))
    assert [run.state for run in dashboard.queue.runs] == ["failed", "waiting"]
    assert "reset_fault" in dashboard.queue.runs[0].message
    commands.refusal = ""
    dashboard.queue.retry(1)
    dashboard.queue.paused = False
    assert asyncio.run(run_next(dashboard))
    assert asyncio.run(run_next(dashboard))
    assert [run.state for run in dashboard.queue.runs] == ["failed", "done", "done"]


def test_the_queue_outlives_the_page(tmp_path: Path) -> None:
    file = tmp_path / "queue.json"
    queue = RunQueue(file)
    queue.start(queue.add("first", SINE, 5.0).number, tmp_path / "bag")
    queue.add("second", SINE, 5.0)
    again = RunQueue(file)
    assert [run.state for run in again.runs] == ["stopped", "waiting"]
    # Nothing moves because somebody has started a page.
    assert again.next() is None
    assert again.add("third", SINE, 5.0).number == 3
    file.write_text("no JSON")
    assert RunQueue(file).runs == []


def test_the_run_under_way_stays_in_the_queue(tmp_path: Path) -> None:
    queue = RunQueue()
    run = queue.add("sine", SINE, 5.0)
    queue.start(run.number, tmp_path)
    with pytest.raises(InputError, match="stop it first"):
        queue.remove(run.number)
    queue.end(run.number, "done", "", "")
    queue.remove(run.number)
    assert queue.runs == []


# Acting


def test_only_who_holds_control_commands(dashboard, commands) -> None:
    refused = asyncio.run(dashboard.call(ANN, "home"))
    assert not refused.success
    assert "Take control" in refused.message
    assert commands.asked == []
    dashboard.control.take("a", "Ann")
    assert asyncio.run(dashboard.call(ANN, "home")).success
    assert not asyncio.run(dashboard.call(BOB, "home")).success
    assert commands.asked == ["home"]
    log = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [(entry["who"], entry["action"], entry["result"].split(":")[0]) for entry in log] == [
        ("Ann", "home", "refused"),
        ("Ann", "home", "home"),
        ("Bob", "home", "refused"),
    ]


def test_everybody_may_stop(dashboard, commands) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.add("sine", SINE, 5.0)
    assert asyncio.run(dashboard.call(BOB, "end run")).success
    dashboard.emergency_stop(BOB)
    assert commands.asked == ["end run", "emergency stop"]
    assert dashboard.queue.next() is None


def test_a_stop_from_elsewhere_lets_the_next_run_wait(dashboard, commands) -> None:
    for _ in range(3):
        dashboard.queue.add("sine", SINE, 5.0)
    dashboard.bench.stops = 4  # before the queue has heard of the bench
    assert asyncio.run(run_next(dashboard))
    dashboard.bench.stops = 5
    assert not asyncio.run(run_next(dashboard))
    dashboard.queue.paused = False
    assert asyncio.run(run_next(dashboard))
    assert [run.state for run in dashboard.queue.runs] == ["done", "done", "waiting"]
    assert commands.stops == [4, 5], "the bench refuses what was sent before the page has heard of a stop"


def test_what_was_asked_for_before_a_stop_is_not_added_after_it(dashboard) -> None:
    for stop in (lambda: dashboard.emergency_stop(BOB), lambda: asyncio.run(dashboard.call(BOB, "end run"))):
        stops = dashboard.queue.stops
        dashboard.queue.require_no_stop_since(stops)
        stop()
        with pytest.raises(InputError, match=r"^somebody stopped the bench meanwhile"):
            dashboard.queue.require_no_stop_since(stops)


def test_a_refusal_of_the_bench_reaches_the_operator(dashboard, commands) -> None:
    dashboard.control.take("a", "Ann")
    commands.refusal = "home is refused: the bench is in mode fault"
    answer = asyncio.run(dashboard.call(ANN, "home"))
    assert (answer.success, answer.message) == (False, commands.refusal)

"""Sequential diagnosis: what is recorded next, why it ends, and how an interrupted one goes on."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import unescape
from math import log
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_diagnosis.diagnose import diagnose
from mrd_diagnosis.diagnosis import Advice, Cause, Gap, Interval, Rejected
from mrd_diagnosis.experiment_design.experiment_library import Sizes, usual_bench
from mrd_diagnosis.experiment_design.information import expected_information
from mrd_diagnosis.experiment_design.separation import Separation
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.sequential import recorded, sequential
from mrd_diagnosis.sequential.first_set import FIRST_SET, first_set
from mrd_diagnosis.sequential.recorded import folder_of_round, read_later_rounds, read_recorded, set_aside_incomplete
from mrd_diagnosis.sequential.report import ending_clause, write_sequential_report
from mrd_diagnosis.sequential.sequential import diagnose_sequentially, open_candidates
from mrd_diagnosis.wording.quantities import probability_clause
from mrd_runs import Run, read_run
from mrd_runs.bag_import import write_bag
from mrd_sim.models import MODELS
from mrd_sim.simulate import Damper, measure_plans
from mrd_trajectory.experiment import Experiment, format_experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.waveforms import Constant
from mrd_trajectory.waveforms.sine import Sine

BENCH = GeneratorSettings()
BOUC_WEN = {
    "yield_force": 80.0,
    "yield_force_per_A": 900.0,
    "yield_travel": 125e-6,
    "viscous": 900.0,
    "viscous_per_A": 2500.0,
    "stiffness": 1500.0,
    "offset": -45.0,
}
LAG, DELAY = "force_sensor_lag", "channel_delay"
FEW = (LAG, DELAY, "gas_spring")


class SimulatedBench:
    """Measures a damper along what it is asked for, and remembers what that was."""

    def __init__(self, damper: Damper, change: Callable[[Run], Run]) -> None:
        self._damper, self._change = damper, change
        self.asked: list[tuple[int, list[str]]] = []

    def __call__(self, number: int, plans: Sequence[Plan]) -> list[Run]:
        self.asked.append((number, [planned.experiment.name for planned in plans]))
        runs = measure_plans(plans, self._damper, np.random.default_rng([number, len(self.asked)]))
        return [self._change(replace(run, name=planned.experiment.name)) for planned, run in zip(plans, runs, strict=True)]


def bench_with(effects: dict[str, dict[str, float]], change: Callable[[Run], Run] = lambda run: run) -> SimulatedBench:
    """Return a bench whose damper has effects, and whose recordings may be changed."""
    return SimulatedBench(Damper("bouc_wen", BOUC_WEN, None, effects), change)


@given(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=4), st.floats(0.0, 1e3), st.floats(1.0, 10.0))
def test_information_grows_with_the_distance_up_to_the_entropy(probabilities, distance, factor):
    names = [f"e{number}" for number in range(len(probabilities))]
    pairs = [(a, b) for place, a in enumerate(names) for b in names[place + 1 :]]
    of = dict(zip(names, probabilities, strict=True))
    near = expected_information(of, {pair: Separation(distance) for pair in pairs})
    far = expected_information(of, {pair: Separation(distance * factor) for pair in pairs})
    shares = np.array(probabilities) / sum(probabilities)
    assert 0.0 <= near <= far + 1e-12
    assert far <= -np.sum(shares * np.log(shares)) + 1e-12
    assert expected_information(of, {pair: Separation(0.0) for pair in pairs}) == pytest.approx(0.0, abs=1e-12)
    certain = expected_information({"a": 1.0, "b": 1.0}, {("a", "b"): Separation(1e9)})
    assert certain == pytest.approx(log(2.0))


def test_a_formula_that_may_be_wrong_gives_less_information():
    exact, wrong = (Separation(400.0, tempering=tempering) for tempering in (1.0, 0.01))
    probabilities = {"a": 0.5, "b": 0.5}
    assert expected_information(probabilities, {("a", "b"): wrong}) < expected_information(
        probabilities, {("a", "b"): exact}
    )


def test_the_first_set_is_short_and_within_the_limits_of_a_small_bench():
    weak = replace(BENCH, limits=replace(BENCH.limits, stroke=0.02, force=300.0, speed=0.1))
    for bench in (BENCH, weak):
        plans = first_set(bench)
        assert [planned.experiment.name for planned in plans] == list(FIRST_SET)
        assert sum(planned.duration for planned in plans) < 60.0
        assert all(planned.peaks[0].value <= bench.limits.reach * 1e3 * (1 + 1e-6) for planned in plans)


@pytest.mark.parametrize(
    "sizes",
    [Sizes(motion=3.0), Sizes(current=4.0), Sizes(0.23, 9.4, 0.078), Sizes(3.2, 4.0, 0.005), Sizes(0.3, 0.3, 0.3)],
    ids=str,
)
def test_the_first_set_uses_as_much_of_any_bench_as_of_the_shipped_one(sizes):
    def used(bench: GeneratorSettings) -> np.ndarray:
        kinds = ("position", "speed", "largest current", "expected force")
        return np.array([[p.value / p.limit for p in planned.peaks if p.quantity in kinds] for planned in first_set(bench)])

    assert used(usual_bench(sizes)) == pytest.approx(used(BENCH), rel=1e-6)


def test_a_healthy_damper_needs_one_round():
    bench = bench_with({})
    outcome = diagnose_sequentially(bench, "bouc_wen", bench=BENCH, effects=FEW)
    assert (outcome.ending, outcome.diagnosis.verdict) == ("no_gap", "no_gap")
    assert bench.asked == [(1, [FIRST_SET[0]]), (1, list(FIRST_SET[1:]))]
    assert len(outcome.rounds) == 1
    assert outcome.duration == pytest.approx(sum(run.duration for run in outcome.diagnosis.runs))


OPEN = {
    "hysteretic_biviscous": "the sign of its acceleration is not known while the speed is constant",
    "gamota_filisko": "the fit ends at other stiffnesses of its solid than the true ones",
}
"""Models whose healthy damper is not recognised yet, and why."""


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "model", [pytest.param(m, marks=pytest.mark.xfail(strict=True, reason=OPEN[m])) if m in OPEN else m for m in MODELS]
)
def test_a_healthy_damper_of_any_model_has_no_gap_around_it(model):
    values = {p.name: p.default for p in MODELS[model].parameters if p.name != "coil_lag"}
    runs = SimulatedBench(Damper(model, values), lambda run: run)(1, first_set(BENCH))
    assert diagnose(runs, model, bench=BENCH).verdict == "no_gap"


def test_a_fault_of_the_measurement_ends_it_after_the_first_recording():
    bench = bench_with({}, lambda run: replace(run, force=-run.force))
    outcome = diagnose_sequentially(bench, "bouc_wen", bench=BENCH, effects=FEW)
    assert (outcome.ending, outcome.diagnosis.verdict) == ("data_fault", "data_fault")
    assert bench.asked == [(1, [FIRST_SET[0]])]


def test_what_is_recorded_next_names_the_cause_that_the_first_recordings_leave_open(tmp_path):
    """On two sines, a lag and a delay look alike."""
    sines = [
        plan(
            Experiment(f"sine{number}", 6.0, 500.0, Sine(amplitude, 1.0), Constant(0.2)), BENCH.limits, BENCH.force_envelope
        )
        for number, amplitude in enumerate((8e-3, 4e-3))
    ]
    bench = bench_with({LAG: {"lag": 1.5e-3}})
    rounds = []
    outcome = diagnose_sequentially(
        bench, "bouc_wen", bench=BENCH, effects=FEW, first=sines, budget=60.0, on_round=rounds.append
    )
    assert rounds == list(outcome.rounds)
    assert len(rounds[0].candidates) > 1
    assert len(rounds) > 1
    further = [names for number, names in bench.asked if number > 1]
    assert all(len(names) == 1 for names in further)
    assert len({name for names in further for name in names}) == len(further)
    assert outcome.duration <= 65.0
    assert [cause.effect for cause in outcome.diagnosis.causes] == [LAG]
    assert outcome.ending == "cause_known"
    assert outcome.why == f"The cause has {probability_clause(outcome.diagnosis.causes[0].probability)}."
    for of_round in rounds:
        folder = folder_of_round(tmp_path, of_round.number) / "report"
        folder.mkdir(parents=True)
        write_gap_report(of_round.diagnosis, folder)
    page = unescape(write_sequential_report(outcome, tmp_path).read_text())
    written = json.loads((tmp_path / "diagnosis.json").read_text())
    assert written["ending"] == outcome.ending
    assert [entry["recordings"] for entry in written["rounds"]] == [[run.name for run in each.runs] for each in rounds]
    for entry in written["rounds"]:
        assert (tmp_path / entry["report"]).exists()
        assert entry["added"] in page


def test_a_budget_that_the_first_recordings_exceed_is_refused_before_anything_moves():
    bench = bench_with({})
    with pytest.raises(InputError, match=r"budget: found 10 s of bench time, expected at least \d+ s"):
        diagnose_sequentially(bench, "bouc_wen", bench=BENCH, budget=10.0)
    assert bench.asked == []


def record(planned: Plan, folder: Path, share: float = 1.0, started: str = "") -> None:
    """Write the bag of an experiment, of which a share is recorded."""
    (run,) = measure_plans([planned], Damper("bouc_wen", BOUC_WEN), np.random.default_rng(1))
    count = int(share * len(run))
    columns = {"time_s": run.time, "position_m": run.position, "current_A": run.current, "force_N": run.force}
    kept = {name: values[:count] for name, values in columns.items()}
    write_bag(kept, [], Path("run.csv"), folder / planned.experiment.name, {"started": started})


def test_what_a_stop_has_cut_is_kept_aside_and_recorded_again_however_often(tmp_path):
    whole, cut = first_set(BENCH)[:2]
    record(whole, tmp_path)
    for number in (1, 2):
        record(cut, tmp_path, 0.3)
        with pytest.raises(InputError, match=rf"{cut.experiment.name}: holds .* s, expected the"):
            read_recorded([whole, cut], tmp_path)
        aside = tmp_path / "incomplete" / f"{cut.experiment.name}_{number}"
        assert set_aside_incomplete([whole, cut], tmp_path) == [aside]
        assert read_run(aside).duration == pytest.approx(0.3 * cut.duration, abs=0.1)
    record(cut, tmp_path)
    assert set_aside_incomplete([whole, cut], tmp_path) == []
    assert [run.name for run in read_recorded([whole, cut], tmp_path)] == [whole.experiment.name, cut.experiment.name]


def test_what_cannot_be_read_is_kept_aside_and_what_is_not_there_is_not_missed(tmp_path):
    empty, absent = first_set(BENCH)[:2]
    (tmp_path / empty.experiment.name).mkdir()
    assert set_aside_incomplete([empty, absent], tmp_path) == [tmp_path / "incomplete" / f"{empty.experiment.name}_1"]
    assert not (tmp_path / empty.experiment.name).exists()


def test_what_is_seen_but_not_determined_stays_a_candidate():
    def entry(effect, rule, chosen):
        return Rejected(effect, rule, "", chosen, 0.7, 0.01, Interval(0.6), {})

    rejected = entry(LAG, "on_bound", True), entry(DELAY, "on_bound", False), entry("backlash", "little", True)
    diagnosis = SimpleNamespace(causes=(), alternatives=(), rejected=rejected)
    assert open_candidates(diagnosis) == {LAG: 0.7}


def test_the_ending_says_what_is_true_of_the_verdict():
    cause = Cause(LAG, 0.95, 0.01, Interval(0.4), {})
    gap = Gap(Interval(0.01), Interval(0.1), Interval(0.08), Interval(0.4))
    single = SimpleNamespace(effects=(LAG,), closed_fraction=Interval(0.12))

    def ended(verdict, causes=(), candidates=(), nearest=None, rejected=()):
        diagnosis = SimpleNamespace(
            verdict=verdict,
            causes=causes,
            alternatives=(),
            gap=gap,
            candidates=candidates,
            nearest=nearest,
            rejected=rejected,
            next_experiment=None,
        )
        ending, why = sequential._ending(diagnosis, (), 100.0)
        return ending_clause(SimpleNamespace(ending=ending, diagnosis=diagnosis)), why

    assert ended("explained", (cause,)) == ("the cause is known", "The cause has a probability of 95 %.")
    assert ended("partly_explained", (cause,)) == (
        "the cause of a part of the gap is known",
        "The cause has a probability of 95 %; 60 % of the gap stays open.",
    )
    assert ended("unknown_effect")[1] == "These recordings cannot test any effect of the catalogue."
    assert ended("unknown_effect", (), (single,))[1].startswith("No effect of the catalogue predicts")
    clause, why = ended("unknown_effect", (), (single,), single)
    assert clause == "no effect of the catalogue explains the gap"
    assert why.endswith("explains the gap. Lag of the force sensor comes nearest: it removes 12 % of it.")
    seen = Rejected(LAG, "on_bound", "", True, 0.7, 0.01, Interval(0.6), {})
    assert ended("ambiguous", (), (single,), single, (seen,))[1].startswith("An effect is seen")


def test_what_a_round_adds_is_told_without_ruling_out_what_is_unlikely():
    before, after = {DELAY: 0.5, LAG: 0.4}, {DELAY: 0.9, "gas_spring": 0.06}
    assert sequential._added(before, after, SimpleNamespace(verdict="explained")) == (
        "Lag of the force sensor is no longer likely, and gas spring may be the cause as well. "
        "Delay of the force channel has a probability of 90 %, 50 % before."
    )


def test_recordings_of_later_rounds_count_from_the_first_one_on(monkeypatch):
    """A measurement by hand makes other experiments come next; what was recorded for the former ones is no less true."""
    seen = []

    def diagnosed(runs, *_, progress, **__):
        seen.append([run.name for run in runs])
        return SimpleNamespace(
            verdict="ambiguous", causes=(), alternatives=(), rejected=(), next_experiment=Advice("", experiment), sentence=""
        )

    monkeypatch.setattr(sequential, "diagnose", diagnosed)
    monkeypatch.setattr(sequential, "preflight", lambda runs: ())
    experiment = format_experiment(first_set(BENCH)[0].experiment)
    bench = bench_with({})
    first, by_hand, later = bench(1, first_set(BENCH)[:1]), bench(9, first_set(BENCH)[1:2]), bench(2, first_set(BENCH)[2:3])
    numbers = []

    def record(number, plans):
        numbers.append(number)
        return [replace(first[0], name=f"recorded_{number}")] if plans else []

    found = diagnose_sequentially(
        record,
        "bouc_wen",
        bench=BENCH,
        budget=60.0,
        first=first_set(BENCH)[:1],
        further=by_hand,
        earlier=later,
        earlier_rounds=3,
    )
    assert seen[0] == ["recorded_1", later[0].name, by_hand[0].name]
    assert [one.number for one in found.rounds] == [1, 5, 6]
    assert set(numbers) == {1, 5, 6}
    # They take their share of the budget.
    assert found.rounds[0].duration == first[0].duration + later[0].duration
    assert found.ending == "budget"


def test_a_recording_counts_once():
    bench = bench_with({})
    (run,) = bench(1, first_set(BENCH)[:1])
    known = replace(run, info={**run.info, "checksum": "abc"})
    with pytest.raises(InputError, match=r"copy: is the recording .* of this diagnosis; leave it out"):
        diagnose_sequentially(
            lambda number, plans: [known] if plans else [],
            bench=BENCH,
            first=first_set(BENCH)[:1],
            further=[replace(known, name="copy")],
        )


def test_later_rounds_are_read_without_reports_and_what_is_incomplete(tmp_path):
    first, second, tenth, other = first_set(BENCH)
    recorded_in = (first, "round_1"), (second, "round_2"), (tenth, "round_10"), (first, "round_2/incomplete")
    for planned, folder in (*recorded_in, (first, "round_2_old")):
        (tmp_path / folder).mkdir(parents=True)
        record(planned, tmp_path / folder, started="2024-05-31T10:00:00+00:00")
    record(other, tmp_path / "round_2", started="2024-05-31T11:00:00+00:00")
    (tmp_path / "round_2" / "report").mkdir()
    (tmp_path / "round_3").touch()
    runs, rounds = read_later_rounds(tmp_path)
    names = [Path(run.info["source"]).name for run in runs]
    assert names == [second.experiment.name, other.experiment.name, tenth.experiment.name]
    assert names[1] < names[0]
    assert rounds == 9
    assert read_later_rounds(tmp_path / "round_1") == ([], 0)


def test_a_recording_that_has_lost_samples_is_recorded_again(tmp_path, monkeypatch):
    planned = first_set(BENCH)[0]
    record(planned, tmp_path)
    assert set_aside_incomplete([planned], tmp_path) == []
    read = recorded.read_run
    monkeypatch.setattr(recorded, "read_run", lambda bag: replace(run := read(bag), info={**run.info, "lost": 40}))
    assert set_aside_incomplete([planned], tmp_path) == [tmp_path / "incomplete" / f"{planned.experiment.name}_1"]

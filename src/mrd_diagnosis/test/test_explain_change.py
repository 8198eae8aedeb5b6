"""What has changed between recordings from before and after, although the model has another form than the damper."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis import diagnose, explain_change
from mrd_diagnosis.decision.verdict import verdict_on_change
from mrd_diagnosis.diagnose import candidates_for
from mrd_diagnosis.report.gap_file import read_gap_report, to_json
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.correction import correction_of_report
from mrd_identification.recording import consecutive_forces, prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model

CANDIDATES = ("moving_mass", "load_cell_gain", "gas_spring", "shear_thinning", "joint_play")
BEFORE, AFTER = range(3), range(3, 6)
RATE, DURATION = 250.0, 6.0


def run(seed, yielded=1.0, viscous=1.0, reach=1.0, rate=RATE, duration=DURATION):
    """Record a damper that no model of the catalogue describes, along a motion and a current of its own.

    ``yielded`` and ``viscous`` are factors of a fluid's yield force and viscous force, ``reach`` is one of the motion.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(duration * rate)) / rate
    x, v, a = np.zeros((3, len(t)))
    for amplitude, frequency in ((7e-3, 0.7), (4e-3, 1.9), (2e-3, 3.7)):
        w, phase = 2 * np.pi * frequency, rng.uniform(0, 6)
        amplitude *= reach
        x += amplitude * np.sin(w * t + phase)
        v += amplitude * w * np.cos(w * t + phase)
        a -= amplitude * w**2 * np.sin(w * t + phase)
    current = np.repeat(rng.uniform(0, 0.5, 10), len(t) // 10)
    knee = np.arctan((v + 2e-3 * np.tanh(a / 0.3)) / (0.006 + 0.01 * current)) / 1.6
    force = yielded * (50.0 + 500.0 * np.sqrt(current)) * knee + viscous * (600.0 + 800.0 * current) * v
    return Run(f"run{seed}", t, x, v, current, force + rng.normal(0, 1.5, len(t))), a


def runs(seeds):
    return [run(seed)[0] for seed in seeds]


def changed(share=0.0, mass=0.0):
    """Return other runs of the same damper; ``share`` scales the force, ``mass`` in kg moves with the rod."""
    return [replace(of_run, force=(1.0 + share) * (of_run.force + mass * a)) for of_run, a in map(run, AFTER)]


def stopped(of_run, stiffness):
    """Return a run with an end stop at 8 mm, of a stiffness in N/m."""
    beyond = np.sign(of_run.position) * np.maximum(np.abs(of_run.position) - 8e-3, 0.0)
    return replace(of_run, force=of_run.force + stiffness * beyond)


def widen(monkeypatch, effect):
    """Let the size of an effect be ten times larger: at the limit of its range, it would be seen, but not named."""
    size, *others = EFFECTS[effect].parameters
    wide = replace(size, lower=10 * size.lower, upper=10 * size.upper)
    monkeypatch.setitem(EFFECTS, effect, replace(EFFECTS[effect], parameters=(wide, *others)))


@pytest.mark.parametrize(
    ("change", "effect"),
    [pytest.param({"share": 0.08}, "load_cell_gain", marks=pytest.mark.slow), ({"mass": 12.0}, "moving_mass")],
    ids=lambda value: str(value),
)
def test_a_change_is_named_although_the_model_has_another_form(change, effect, monkeypatch):
    widen(monkeypatch, "moving_mass")
    diagnosis = diagnose(changed(**change), "bouc_wen", reference=runs(BEFORE), effects=CANDIDATES)
    assert diagnosis.verdict in ("explained", "ambiguous", "partly_explained")
    assert diagnosis.causes[0].effect == effect
    assert diagnosis.causes[0].closed_fraction.value > 0.5
    assert [run.name for run in diagnosis.reference] == [f"run{seed}" for seed in BEFORE]
    assert {residual.recording.run.name for residual in diagnosis.residuals} == {f"run{seed}" for seed in AFTER}


@pytest.mark.parametrize(
    ("yielded", "viscous", "leads"),
    [(0.85, 1.2, True), pytest.param(1.25, 1.0, False, marks=pytest.mark.slow)],
    ids=["weaker and thicker", "stronger"],
)
def test_another_fluid_is_not_taken_for_an_error_of_a_sensor(yielded, viscous, leads):
    """Recordings cannot tell a fluid that is only stronger from a load cell with another gain, and say so."""
    after = [run(seed, yielded, viscous)[0] for seed in AFTER]
    effects = ("load_cell_gain", "lvdt_nonlinearity", "current_sensor_error", "fluid_change", "thermal_fade")
    diagnosis = diagnose(after, "bouc_wen", reference=runs(BEFORE), effects=effects)
    assert diagnosis.verdict in ("explained", "ambiguous")
    assert not leads or diagnosis.causes[0].effect == "fluid_change"
    assert "fluid_change" in {option.effect for option in (*diagnosis.causes, *diagnosis.alternatives)}
    assert diagnosis.verdict == "ambiguous" or [cause.effect for cause in diagnosis.causes] == ["fluid_change"]


def test_another_fluid_needs_a_reference():
    with pytest.raises(InputError, match=r"effect fluid_change shows only as a change .* name them by --reference"):
        diagnose(runs(BEFORE), "bouc_wen", effects=("fluid_change",))
    assert "fluid_change" not in candidates_for((), is_change=False)
    assert "fluid_change" in candidates_for((), is_change=True)


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_nothing_is_named_in_single_runs_where_nothing_changed(seed):
    effects = (*CANDIDATES, "coil_lag", "thermal_fade", "flow_asymmetry", "seal_friction")
    diagnosis = diagnose(runs([seed]), "bouc_wen", reference=runs(BEFORE[:1]), effects=effects)
    assert diagnosis.causes == ()
    assert any("record at least two before and two after" in note for note in diagnosis.notes)


@pytest.mark.parametrize("seeds", [pytest.param(BEFORE, marks=pytest.mark.slow), AFTER], ids=["the same runs", "other runs"])
def test_nothing_is_named_where_nothing_changed(seeds):
    diagnosis = diagnose(runs(seeds), "bouc_wen", reference=runs(BEFORE), effects=CANDIDATES)
    assert diagnosis.causes == ()
    assert diagnosis.verdict == "no_gap"


@pytest.fixture(scope="module")
def of_gain():
    """The diagnosis of a load cell whose gain has risen by 8 %."""
    return diagnose(changed(share=0.08), "bouc_wen", reference=runs(BEFORE), effects=("load_cell_gain",))


def test_a_size_of_a_change_is_right(of_gain):
    (value,) = of_gain.causes[0].parameters.values()
    assert value.value.value == pytest.approx(0.08, abs=0.01)


def test_the_report_of_a_change_names_the_reference_runs(of_gain, tmp_path):
    assert of_gain.sentence.startswith("Something has changed since the reference runs. The load cell's gain is off by 7")
    assert "of the change." in of_gain.sentence
    page = write_gap_report(of_gain, tmp_path)
    assert "compared with 3 from before a change" in page.read_text(encoding="utf-8")
    content = read_gap_report(tmp_path / "gap_report.json")
    assert [run["name"] for run in content["runs"]["reference"]] == ["run0", "run1", "run2"]
    assert [run["name"] for run in content["runs"]["fit"]] == ["run3", "run4", "run5"]


def test_a_difference_no_larger_than_the_scatter_of_the_runs_is_no_change():
    gains = iter((1.0, 1.06, 0.95, 1.01, 1.07, 0.97))
    scattered = [replace(of_run, force=next(gains) * of_run.force) for of_run in runs(range(6))]
    diagnosis = diagnose(scattered[3:], "bouc_wen", reference=scattered[:3], effects=("load_cell_gain", "moving_mass"))
    assert diagnosis.causes == ()


def test_an_effect_in_an_error_no_larger_than_the_noise_is_no_change():
    """An end stop was named in it, without a share: there was nothing of which it could close one."""
    noise = SimpleNamespace(sigma=np.ones(40))
    folds = [(0, slice(10 * k, 10 * k + 10)) for k in range(4)]
    base = SimpleNamespace(chi_square=0.95, held_out_squares=np.full(4, 9.5))
    best = SimpleNamespace(chi_square=0.6, held_out_squares=np.full(4, 6.0), held_out_chi_squares=np.full(4, 6.0))
    weighting = SimpleNamespace(noise=[noise], folds=folds, recordings=[SimpleNamespace(without_effects=False)])
    comparison = SimpleNamespace(effects=("end_stop",), base=base, best=best, weighting=weighting)
    probabilities = {"end_stop": {"end_stop": 0.95}}
    assert verdict_on_change(comparison, probabilities, np.random.default_rng(0)) == "no_gap"
    comparison.base = SimpleNamespace(chi_square=2.0, held_out_squares=np.full(4, 20.0))
    assert verdict_on_change(comparison, probabilities, np.random.default_rng(0)) == "explained"


def test_an_end_stop_that_one_run_before_reached_by_far_is_named():
    """That run tells so much of it that the other runs from before tell little beside it, but enough."""
    before = [run(0, reach=1.6)[0], *(run(seed, reach=0.8)[0] for seed in (1, 2, 3))]
    after = [run(seed)[0] for seed in (4, 5, 6, 7)]
    diagnosis = diagnose(
        [stopped(of_run, 2e5) for of_run in after],
        "bouc_wen",
        reference=before,
        effects=("end_stop", "moving_mass", "joint_play"),
    )
    assert [cause.effect for cause in diagnosis.causes] == ["end_stop"]


@pytest.mark.parametrize("stiffnesses", [(0.0, 0.0), (2.1e5, 1.9e5)], ids=["unchanged", "with an end stop"])
def test_two_runs_before_and_two_after_that_reach_an_end_stop_tell_of_it(stiffnesses):
    """Its sizes differed by a few per cent, and with a variance for each side a test knows next to nothing of two runs."""
    reaches = (1.2, 1.0, 0.5, 0.5)
    before = [run(seed, reach=reach)[0] for seed, reach in enumerate(reaches)]
    after = [run(seed, reach=reach)[0] for seed, reach in enumerate(reaches, 4)]
    after = [*map(stopped, after, stiffnesses), *after[2:]]
    diagnosis = diagnose(after, "bouc_wen", reference=before, effects=("end_stop", "moving_mass", "joint_play"))
    assert [cause.effect for cause in diagnosis.causes] == (["end_stop"] if any(stiffnesses) else [])


def test_a_change_is_seen_where_the_noise_was_estimated_too_large():
    """At 100 Hz, the estimate exceeds what a function free to differ leaves, and a gain of 20 % was no change."""
    before = [run(seed, rate=100.0, duration=5.0)[0] for seed in BEFORE]
    after = [run(seed, rate=100.0, duration=5.0)[0] for seed in AFTER]
    after = [replace(of_run, force=1.2 * of_run.force) for of_run in after]
    diagnosis = diagnose(after, "bouc_wen", reference=before, effects=CANDIDATES)
    assert [cause.effect for cause in diagnosis.causes] == ["load_cell_gain"]
    assert diagnosis.gap.noise_floor.value < diagnosis.gap.before.value


def test_what_is_new_after_the_change_and_has_no_name_is_not_made_up_for_by_the_runs_before():
    """A ripple of 60 N raised the floor of all runs; those from before fell below it, and 6 % of the change was all."""
    before = [run(seed, rate=200.0, duration=5.0)[0] for seed in BEFORE]
    after = [run(seed, rate=200.0, duration=5.0)[0] for seed in AFTER]
    after = [replace(r, force=1.15 * r.force + 60.0 * np.sin(2 * np.pi * r.position / 4e-3)) for r in after]
    diagnosis = diagnose(after, "bouc_wen", reference=before, effects=CANDIDATES)
    assert diagnosis.verdict != "explained" or diagnosis.gap.closed_fraction.value >= THRESHOLDS.least_closed


def test_a_change_that_depends_on_the_position_is_no_noise(monkeypatch):
    """The function that may differ after the change does not depend on it: what it left counted as noise, 4.4 % of 5.0 %."""
    after = [replace(r, force=r.force + 4e3 * np.abs(r.position) * np.tanh(r.velocity / 2e-3)) for r in runs(AFTER)]
    widen(monkeypatch, "side_load_friction")
    effects = ("load_cell_gain", "side_load_friction", "shear_thinning")
    diagnosis = diagnose(after, "bouc_wen", reference=runs(BEFORE), effects=effects)
    assert [cause.effect for cause in diagnosis.causes] == ["side_load_friction"]
    assert diagnosis.gap.noise_floor.value < 0.7 * diagnosis.gap.before.value


def test_an_effect_that_does_not_hold_takes_no_other_with_it(monkeypatch):
    whole = explain_change.exceeds_run_scatter
    monkeypatch.setattr(
        explain_change, "exceeds_run_scatter", lambda refitted, effect: effect != "moving_mass" and whole(refitted, effect)
    )
    effects = ("load_cell_gain", "moving_mass")
    diagnosis = diagnose(changed(share=0.15, mass=4.0), "bouc_wen", reference=runs(BEFORE), effects=effects)
    assert [cause.effect for cause in diagnosis.causes] == ["load_cell_gain"]


def test_the_corrected_simulator_has_the_parameters_of_the_damper_before_the_change():
    """Those of a fit to the runs before and after held half of the change already, and the effect came on top."""
    diagnosis = diagnose(changed(share=0.2), "bouc_wen", reference=runs(BEFORE), effects=("load_cell_gain",))
    recordings = [prepare_recording(of_run) for of_run in runs(BEFORE)]
    damper = {name: value for name, value in diagnosis.corrected.parameters.items() if "." not in name}
    model = find_model("bouc_wen")
    modelled = np.concatenate(consecutive_forces(model, model.vector(damper), recordings))
    measured = np.concatenate([recording.force for recording in recordings])
    assert modelled @ measured / (modelled @ modelled) == pytest.approx(1.0, abs=0.02)
    assert diagnosis.held_out_by == "blocks"
    remark = correction_of_report(to_json(diagnosis), "it").remark
    assert remark.endswith(
        "parameters refitted to the runs from before and the effect load_cell_gain: this explains the change."
    )


def test_a_change_excludes_held_out_runs():
    recorded = runs(BEFORE)
    with pytest.raises(InputError, match="both reference and held-out runs"):
        diagnose(recorded, "bouc_wen", reference=recorded, held_out=recorded)


def test_effects_do_not_act_before_the_change():
    model = find_model("bouc_wen", effects=["thermal_fade", "load_cell_gain"])
    theta = model.vector({"thermal_fade.fade": 1e-4, "load_cell_gain.gain": 0.1})
    neutral = model.vector({"thermal_fade.fade": 0.0, "load_cell_gain.gain": 0.0})
    before, after = (prepare_recording(run) for run in runs(range(2)))
    before = replace(before, without_effects=True)
    forces = consecutive_forces(model, theta, [before, after])
    assert (forces[0] == consecutive_forces(model, neutral, [before])[0]).all()
    assert (forces[1] == consecutive_forces(model, theta, [after])[0]).all()

"""The ground truth: dissipation, convergence, what an effect changes and what it leaves, instruments, independence."""

import ast
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mrd_trials.truth
from mrd_trials.truth import (
    DAMPER_FORMS,
    EFFECTS,
    BenchCommand,
    TrueInstruments,
    TruePlant,
    draw_parameters,
    draw_scatter,
    record,
)
from mrd_trials.truth.effects.lvdt_nonlinearity import RATED, transducer_reading
from mrd_trials.truth.effects.servo_ripple import rippled_motion
from mrd_trials.truth.instruments import sample_signal
from mrd_trials.truth.integration import damper_force, has_series_element, plant_values, rested_state
from mrd_trials.truth.recording import followed_command

STEP = 1 / 8000

BENCH = TrueInstruments(500.0)
QUIET = TrueInstruments(
    500.0, position=0.0, force=0.0, current=0.0, acceleration=0.0, jitter=0.0, gain_scatter=0.0, offset_scatter=0.0
)

BLIND = {"lvdt_nonlinearity": "position", "current_sensor_error": "current", "sensor_stiction": "position"}
"""Effects that only another channel than the force shows."""

FORMULAS = [(effect.id, formula.id) for effect in EFFECTS.values() for formula in effect.formulas]

FAMILIES = ("development", "evaluation")


def excite(seconds: float = 4.0, step: float = STEP, exact: bool = False, seed: int = 0) -> BenchCommand:
    """Two sines that reach 15 mm and 0.2 m/s, and steps of the current up to 1 A."""
    t = np.arange(round(seconds / step)) * step
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    position = 0.009 * np.sin(2 * np.pi * 1.0 * t) + 0.005 * np.sin(2 * np.pi * 3.5 * t + phase)
    current = np.interp(
        t % 1.2, [0.0, 0.299, 0.3, 0.599, 0.6, 0.899, 0.9, 1.199, 1.2], [0.0, 0.0, 1.0, 1.0, 0.3, 0.3, 0.7, 0.7, 0.0]
    )
    return BenchCommand(t, position, current, exact)


def forces(
    form: str,
    effects: Mapping[str, Mapping[str, float]],
    motions: list[BenchCommand],
    instruments: TrueInstruments = QUIET,
    formulas: Mapping[str, str] | None = None,
) -> np.ndarray:
    plant = TruePlant(form, {}, effects, formulas or {})
    return np.concatenate([run.force for run in record(plant, motions, instruments, np.random.default_rng(4))])


def typical(effect: str, formula: str = "", strength: float = 1.0, seed: int = 3) -> dict[str, float]:
    return EFFECTS[effect].formula(formula).draw(np.random.default_rng(seed), strength)


def test_truth_shares_nothing_with_the_fitted_models() -> None:
    files = list(Path(mrd_trials.truth.__file__).parent.rglob("*.py"))
    assert len(files) > 10
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            assert all(name.startswith("mrd_trials.truth") for name in names if name.startswith("mrd_")), file


def test_the_catalogue_lacks_at_least_eight_effects() -> None:
    assert sum(not effect.in_catalogue for effect in EFFECTS.values()) >= 8
    assert [form.id for form in DAMPER_FORMS.values() if not form.perturbed] == ["bouc_wen"]


def test_every_effect_has_formulas_of_both_families_and_no_other_effect_has_them() -> None:
    for effect in EFFECTS.values():
        assert len({formula.id for formula in effect.formulas}) == len(effect.formulas) >= 3, effect.id
        assert {formula.family for formula in effect.formulas} == set(FAMILIES), effect.id
        assert all(set(formula.shared) <= {entry.name for entry in formula.parameters} for formula in effect.formulas)
    for family in FAMILIES:
        assert sum(form.family == family for form in DAMPER_FORMS.values()) >= 3
    assert len({form.code for form in DAMPER_FORMS.values()}) == len(DAMPER_FORMS)


@pytest.mark.parametrize("effect", EFFECTS)
def test_formulas_of_the_two_families_differ_in_what_they_do(effect: str) -> None:
    """A name alone would not keep them apart: beyond a factor, each changes the recordings in its own way."""
    t = np.arange(16000) * STEP
    current = 0.3 + 0.2 * np.sin(2 * np.pi * 0.9 * t) + 0.06 * np.sin(2 * np.pi * 4.0 * t)
    motions = [excite(12.0), BenchCommand(t, excite(2.0, seed=1).position, current)]

    def change(formula: str) -> np.ndarray:
        plant = TruePlant("bouc_wen", {}, {effect: typical(effect, formula)}, {effect: formula})
        with_effect, without = (
            record(one, motions, QUIET, np.random.default_rng(0)) for one in (plant, TruePlant("bouc_wen", {}))
        )
        changed = [
            getattr(a, BLIND.get(effect, "force")) - getattr(b, BLIND.get(effect, "force"))
            for a, b in zip(with_effect, without, strict=True)
        ]
        return np.concatenate(changed)

    changes = {formula.id: change(formula.id) for formula in EFFECTS[effect].formulas}
    unit = {name: values / np.linalg.norm(values) for name, values in changes.items()}
    for one in EFFECTS[effect].formulas:
        for other in EFFECTS[effect].formulas:
            if one.family != other.family:
                assert abs(float(unit[one.id] @ unit[other.id])) < 0.9999, (one.id, other.id)


def test_a_family_draws_only_its_own_formulas_and_all_of_them() -> None:
    for effect in EFFECTS.values():
        for family in FAMILIES:
            drawn = {effect.draw_formula(family, np.random.default_rng(seed)) for seed in range(60)}
            assert drawn == {formula.id for formula in effect.formulas if formula.family == family}


@settings(max_examples=30)
@given(
    form=st.sampled_from(sorted(DAMPER_FORMS)),
    seed=st.integers(0, 2**16),
    current=st.floats(0.0, 1.5),
    amplitudes=st.lists(st.floats(-4e-3, 4e-3), min_size=3, max_size=3).filter(lambda a: max(map(abs, a)) > 1e-4),
)
def test_a_damper_form_dissipates_over_any_closed_cycle(
    form: str, seed: int, current: float, amplitudes: list[float]
) -> None:
    p = plant_values(form, draw_parameters(form, np.random.default_rng(seed)), {})
    t = np.arange(16001) * STEP  # two periods; over the second, the state is closed as well
    turns = 2 * np.pi * np.array([1.0, 2.0, 5.0])[:, None]
    x = (np.array(amplitudes)[:, None] * np.sin(turns * t)).sum(axis=0)
    v = (np.array(amplitudes)[:, None] * turns * np.cos(turns * t)).sum(axis=0)
    force = damper_force(p, x, v, np.full_like(x, current), STEP, 1.0, has_series_element(form, {}), rested_state())
    work = float(np.sum(0.5 * (force[8001:] + force[8000:-1]) * np.diff(x[8000:])))
    assert work > 0


@pytest.mark.parametrize("form", DAMPER_FORMS)
def test_damper_forms_have_comparable_forces(form: str) -> None:
    force = forces(form, {}, [excite()])
    assert 700 < np.abs(force).max() < 1700
    assert np.std(force - forces("bouc_wen", {}, [excite()])) < 0.45 * np.std(force)


@pytest.mark.parametrize(
    ("form", "effect", "formula"),
    [*((form, "", "") for form in DAMPER_FORMS), *(("bouc_wen", *entry) for entry in FORMULAS), ("spencer", "backlash", "")],
)
def test_converges(form: str, effect: str, formula: str) -> None:
    plant = TruePlant(form, {}, {effect: typical(effect, formula)} if effect else {}, {effect: formula})
    coarse, fine = (
        record(plant, [excite(1.5, step)], replace(QUIET, averaged=False), np.random.default_rng(0))[0].force
        for step in (STEP, STEP / 16)
    )
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.25  # N: a sixth of the noise


@pytest.mark.parametrize(("effect", "formula"), FORMULAS)
def test_without_strength_nothing_changes(effect: str, formula: str) -> None:
    plain, none = (
        record(TruePlant("bouc_wen", {}, effects, {effect: formula}), [excite(1.0)], BENCH, np.random.default_rng(0))[0]
        for effects in ({}, {effect: typical(effect, formula, 0.0)})
    )
    for name in ("position", "current", "acceleration", "force"):
        np.testing.assert_allclose(getattr(none, name), getattr(plain, name), rtol=0, atol=1e-9)


@pytest.mark.parametrize(("effect", "formula"), FORMULAS)
def test_an_effect_shows_more_the_stronger_it_is(effect: str, formula: str) -> None:
    channel = BLIND.get(effect, "force")
    plain, *changed = (
        getattr(
            record(TruePlant("bouc_wen", {}, effects, {effect: formula}), [excite()], QUIET, np.random.default_rng(0))[0],
            channel,
        )
        for effects in ({}, *({effect: typical(effect, formula, strength)} for strength in (0.5, 1.0, 2.0)))
    )
    change = [float(np.sqrt(np.mean((series - plain) ** 2))) for series in changed]
    assert change[0] < change[1] < change[2] * (1 + 1e-9)
    assert change[1] > {"force": 0.02, "position": 5e-6, "current": 2e-3}[channel]
    if effect in BLIND:  # the force of the damper does not change
        with_effect = forces("bouc_wen", {effect: typical(effect, formula)}, [excite()], formulas={effect: formula})
        np.testing.assert_array_equal(with_effect, forces("bouc_wen", {}, [excite()]))


@given(entry=st.sampled_from(FORMULAS), seed=st.integers(0, 2**32), strengths=st.lists(st.floats(0, 10), min_size=2))
def test_parameters_grow_with_strength_and_stay_plausible(entry: tuple[str, str], seed: int, strengths: list[float]) -> None:
    formula = EFFECTS[entry[0]].formula(entry[1])
    drawn = [formula.draw(np.random.default_rng(seed), strength) for strength in sorted(strengths)]
    for parameter in formula.parameters:
        values = [draw[parameter.name] for draw in drawn]
        assert all(parameter.low <= value <= parameter.high for value in values)
        if parameter.grows:
            assert np.all(np.diff(np.abs(values)) >= 0)
            assert len({np.sign(value) for value in values if value}) <= 1
        else:
            assert len(set(values)) == 1
    shared = EFFECTS[entry[0]].shared_sizes(drawn[0], entry[1])
    assert shared == {f"{entry[0]}.{name}": drawn[0][name] for name in formula.shared}


@pytest.mark.parametrize(("effect", "formula"), FORMULAS)
def test_every_effect_gives_finite_forces_on_other_forms(effect: str, formula: str) -> None:
    forms = list(DAMPER_FORMS)
    first = FORMULAS.index((effect, formula))
    for form in (forms[first % len(forms)], forms[(5 * first + 3) % len(forms)], "spencer"):
        parameters = draw_parameters(form, np.random.default_rng(1))
        for strength in (1.0, 6.0):
            plant = TruePlant(form, parameters, {effect: typical(effect, formula, strength)}, {effect: formula})
            readings = record(plant, [excite(0.5)], BENCH, np.random.default_rng(2))[0]
            assert np.isfinite(readings.force).all()
            assert np.abs(readings.force).max() < 3000


def test_all_effects_at_once_give_finite_forces() -> None:
    for family in FAMILIES:
        formulas = {name: effect.draw_formula(family, np.random.default_rng(3)) for name, effect in EFFECTS.items()}
        effects = {effect: typical(effect, formula) for effect, formula in formulas.items()}
        assert np.abs(forces("spencer", effects, [excite(1.0)] * 2, formulas=formulas)).max() < 4000


def test_heat_drift_and_sediment_carry_over() -> None:
    same = [excite(4.0)] * 3

    def ratio(effect: str, **parameters: float) -> np.ndarray:
        readings = forces("bouc_wen", {effect: {**typical(effect), **parameters}}, same) - forces("bouc_wen", {}, same)
        return np.sqrt(np.mean(readings.reshape(3, -1) ** 2, axis=1))

    heat = ratio("thermal_fade", cooling_time=1000.0)
    assert heat[0] < 0.6 * heat[1] < 0.5 * heat[2]
    sediment = ratio("settling", travel=0.3)
    assert sediment[0] > 1.5 * sediment[1] > 1.8 * sediment[2]
    effects = {"load_cell_drift": {"drift": 0.02, "warm_up_time": 1e6}}  # so slow that it is linear
    drift = (forces("bouc_wen", effects, same) - forces("bouc_wen", {}, same)).reshape(3, -1)
    assert np.mean(drift, axis=1) == pytest.approx([0.02 * (2.0 + 34.0 * run) for run in range(3)], rel=1e-2)


def test_the_coil_and_the_iron_remember_the_run_before() -> None:
    motions = [excite(1.0)] * 2
    for effect in ("coil_lag", "magnetic_hysteresis"):
        first, second = forces("bouc_wen", {effect: typical(effect)}, motions).reshape(2, -1)
        assert np.abs(second - first)[:20].max() > 1.0, effect


def test_noise_is_as_declared_and_does_not_depend_on_the_effects() -> None:
    motions = [excite(20.0, seed=seed) for seed in range(2)]
    loud, plain = (
        record(TruePlant("bouc_wen", {}), motions, instruments, np.random.default_rng(7)) for instruments in (BENCH, QUIET)
    )
    still = replace(BENCH, jitter=0.0, gain_scatter=0.0)
    calm = record(TruePlant("bouc_wen", {}), motions, still, np.random.default_rng(7))
    for a, b in zip(calm, plain, strict=True):
        for name in ("position", "current", "acceleration", "force"):
            noise = getattr(a, name) - getattr(b, name)
            assert np.std(noise) == pytest.approx(getattr(BENCH, name), rel=0.05), name
            assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.05
    assert np.std(loud[0].force - plain[0].force) > np.std(calm[0].force - plain[0].force)
    effects = {"channel_crosstalk": {"from_position": 1000.0, "from_current": 0.0, "settling_time": 1e-3}}
    noisy, clean = (
        record(TruePlant("bouc_wen", {}, effects), motions, instruments, np.random.default_rng(7))
        for instruments in (still, QUIET)
    )
    for a, b, c, d in zip(noisy, clean, calm, plain, strict=True):
        np.testing.assert_allclose(a.force - b.force, c.force - d.force, atol=1e-9)


def test_scatter_is_known_without_recording() -> None:
    motions, bench = [excite(0.5)] * 3, replace(QUIET, gain_scatter=0.01, offset_scatter=2.0)
    scatter = draw_scatter(bench, np.random.default_rng(6), len(motions))
    scattered, plain = (
        record(TruePlant("bouc_wen", {}), motions, instruments, np.random.default_rng(6)) for instruments in (bench, QUIET)
    )
    for run, with_scatter, without in zip(scatter, scattered, plain, strict=True):
        np.testing.assert_allclose(with_scatter.force, run.gain * without.force + run.offset, atol=1e-6)


def test_runs_scatter_in_offset_and_gain() -> None:
    motions = [excite(0.5)] * 60
    scattered, plain = (
        np.stack([run.force for run in record(TruePlant("bouc_wen", {}), motions, bench, np.random.default_rng(0))])
        for bench in (replace(QUIET, gain_scatter=0.01, offset_scatter=2.0), QUIET)
    )
    fits = np.array([np.polyfit(b, a, 1) for a, b in zip(scattered, plain, strict=True)])
    assert np.std(fits[:, 0]) == pytest.approx(0.01, rel=0.3)
    assert np.std(fits[:, 1]) == pytest.approx(2.0, rel=0.3)


def test_the_same_seed_gives_the_same_recordings() -> None:
    plant = TruePlant(
        "lugre", draw_parameters("lugre", np.random.default_rng(5)), {"mains_hum": {"amplitude": 2.0, "third": 0.2}}
    )
    one, two, other = (record(plant, [excite(1.0)] * 2, BENCH, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one[1].force, two[1].force)
    assert not np.array_equal(one[1].force, other[1].force)
    assert not np.array_equal(one[0].force, one[1].force)


@pytest.mark.parametrize("averaged", [False, True])
def test_a_sample_is_a_mean_or_an_instantaneous_value(averaged: bool) -> None:
    t = np.arange(40000) * STEP
    bench = replace(QUIET, rate=80.0, averaged=averaged)
    at = np.arange(400) / 80.0
    readings = sample_signal(bench, at, np.zeros_like(at), STEP, 5.0 * np.sin(2 * np.pi * 50.0 * t))
    assert np.std(readings[2:-2]) * np.sqrt(2) == pytest.approx(5.0 * (np.sinc(50.0 / 80.0) if averaged else 1.0), rel=0.02)


@pytest.mark.parametrize("rate", [80.0, 500.0])
def test_hum_has_its_amplitude_at_every_rate(rate: float) -> None:
    t = np.arange(40000) * STEP
    still = BenchCommand(t, np.zeros_like(t), np.zeros_like(t))
    effects = {"mains_hum": {"amplitude": 5.0, "wandering": 1e-9, "period": 5.0}}
    hum, none = (forces("bouc_wen", e, [still], replace(QUIET, rate=rate), {"mains_hum": "grid"}) for e in (effects, {}))
    assert np.std((hum - none)[2:-2]) * np.sqrt(2) == pytest.approx(5.0, rel=0.02)


def test_delay_and_mass_have_their_sizes() -> None:
    """In slow motion, what makes each formula special is small."""
    motion = excite(2.0)
    plain = forces("bouc_wen", {}, [motion])
    late = forces("bouc_wen", {"channel_delay": {"delay": 0.008, "period": 1e9}}, [motion])
    np.testing.assert_allclose(late[10:-5], plain[6:-9], atol=1e-6)
    rod = record(TruePlant("bouc_wen", {}), [motion], QUIET, np.random.default_rng(0))[0].acceleration
    for formula, shapes in (("soft_mount", {"frequency": 150.0, "damping": 0.7}), ("liquid_column", {"length": 1e3})):
        heavy = forces("bouc_wen", {"moving_mass": {"mass": 1.5, **shapes}}, [motion], formulas={"moving_mass": formula})
        np.testing.assert_allclose((heavy - plain)[50:], 1.5 * rod[50:], atol=0.1 * 1.5 * np.abs(rod).max())


@pytest.mark.parametrize("formula", ["two_stages", "bessel"])
def test_a_lag_delays_slow_forces_by_its_size(formula: str) -> None:
    instant = replace(QUIET, rate=8000.0, averaged=False)
    prompt, lagging = (
        forces("bouc_wen", effects, [excite(2.0)], instant, {"force_sensor_lag": formula})
        for effects in ({}, {"force_sensor_lag": {"lag": 0.005}})
    )
    assert np.trapezoid(prompt - lagging, dx=STEP) == pytest.approx(0.005 * (lagging[-1] - prompt[0]), abs=0.05)


@pytest.mark.parametrize("formula", [formula.id for formula in EFFECTS["coil_lag"].formulas])
def test_the_acting_current_settles_at_the_current(formula: str) -> None:
    t = np.arange(16000) * STEP
    step = BenchCommand(t, 0.005 * np.sin(2 * np.pi * t), np.where(t < 1.0, 0.0, 0.5))
    late, prompt = (
        forces("bouc_wen", effects, [step], formulas={"coil_lag": formula})
        for effects in ({"coil_lag": typical("coil_lag", formula)}, {})
    )
    assert np.abs(late - prompt)[500:515].max() > 50.0
    assert np.abs(late - prompt)[750:].max() < 1.0


def test_a_compliance_has_its_size() -> None:
    """Far below the yield force, spring and fluid share all of the rod's travel."""
    t = np.arange(16000) * STEP
    held = BenchCommand(t, 2e-5 * np.sin(2 * np.pi * t), np.ones_like(t), exact=True)
    shapes = {"rubber": {"hardening_force": 2000.0}, "cubic": {"hardening_force": 2000.0}, "kelvin": {"creep_time": 2e-3}}
    for formula, shape in shapes.items():
        effects = {"series_compliance": {"compliance": 1e-6, **shape}}
        stiff, soft = (
            np.ptp(forces("bouc_wen", e, [held], formulas={"series_compliance": formula})[500:]) / 4e-5
            for e in ({}, effects)
        )
        assert 1 / soft - 1 / stiff == pytest.approx(1e-6, rel=0.15), formula


def test_play_is_travel_without_force() -> None:
    t = np.arange(24000) * STEP
    triangle = BenchCommand(t, 0.02 * np.abs((t / 1.0) % 2 - 1) - 0.01, np.full_like(t, 0.5), exact=True)
    plant = {"backlash": {"play": 4e-4, "drag": 10.0}}
    for formula in ("film", "reynolds", "elastic"):
        tight, loose = (forces("bouc_wen", effects, [triangle], formulas={"backlash": formula}) for effects in ({}, plant))
        back = slice(500, 540)  # after the first turn, at 20 mm/s, 40 um a sample
        free = np.sum(np.abs(loose[back]) < 30.0)
        assert 8 <= free <= 12, formula
        np.testing.assert_allclose(loose[560:900], tight[560:900], atol=1.0)


@given(curve=st.floats(-0.05, 0.05), gain=st.floats(-0.1, 0.1))
def test_a_corrected_reading_is_the_position(curve: float, gain: float) -> None:
    x = np.linspace(-0.027, 0.027, 101)
    errors = {
        "quintic": lambda share: 0.8 * share**2 + 0.2 * share**4,
        "rounded": lambda share: np.sin(0.5 * np.pi * share) ** 2,
        "square": np.abs,
    }
    for formula, error in errors.items():
        effects = {"lvdt_nonlinearity": {"curve": curve, "gain": gain}}
        read = transducer_reading(plant_values("bouc_wen", {}, effects, {"lvdt_nonlinearity": formula}), x)
        np.testing.assert_allclose(read * (1 + gain + curve * error(read / RATED)), x, atol=1e-9)


def test_derivatives_of_the_drives_motion_are_consistent() -> None:
    t = np.arange(8000) * STEP
    smooth = 0.01 * np.sin(6 * t), 0.06 * np.cos(6 * t), -0.36 * np.sin(6 * t)
    rippled = [
        rippled_motion(
            plant_values(
                "bouc_wen", {}, {"servo_ripple": formula.draw(np.random.default_rng(0), 1.0)}, {"servo_ripple": formula.id}
            ),
            *smooth,
        )
        for formula in EFFECTS["servo_ripple"].formulas
    ]
    for x, v, a in (followed_command(excite(1.0).position, STEP), *rippled):
        np.testing.assert_allclose(np.gradient(x, STEP)[2:-2], v[2:-2], atol=1e-4)
        np.testing.assert_allclose(np.gradient(v, STEP)[2:-2], a[2:-2], atol=0.05)


def test_a_replayed_motion_is_exact() -> None:
    motion = excite(1.0, exact=True)
    readings = record(TruePlant("bouc_wen", {}), [motion], replace(QUIET, averaged=False), np.random.default_rng(0))[0]
    np.testing.assert_allclose(readings.position, motion.position[::16], atol=1e-12)
    np.testing.assert_allclose(readings.current, motion.current[::16], atol=1e-12)


@given(form=st.sampled_from(sorted(DAMPER_FORMS)), seed=st.integers(0, 2**32))
def test_drawn_parameters_stay_near_their_nominal_values(form: str, seed: int) -> None:
    drawn = draw_parameters(form, np.random.default_rng(seed))
    assert drawn.keys() == DAMPER_FORMS[form].nominal.keys()
    assert all(abs(drawn[name] / value - 1) <= 0.3 + 1e-9 for name, value in DAMPER_FORMS[form].nominal.items())


def test_invalid_input_is_named_in_the_error() -> None:
    t = np.arange(100) * STEP
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="damper form best: unknown"):
        draw_parameters("best", rng)
    with pytest.raises(ValueError, match="effect magic: unknown"):
        record(TruePlant("dahl", {}, {"magic": {}}), [], BENCH, rng)
    with pytest.raises(ValueError, match="effect moving_mass: has parameters none"):
        record(TruePlant("dahl", {}, {"moving_mass": {}}), [], BENCH, rng)
    with pytest.raises(ValueError, match="unknown parameter sigma"):
        record(TruePlant("dahl", {"sigma": 1.0}), [], BENCH, rng)
    with pytest.raises(ValueError, match="equally spaced"):
        BenchCommand(t * 2, t, t)
    with pytest.raises(ValueError, match="finite"):
        BenchCommand(t, t, t * np.nan)
    with pytest.raises(ValueError, match="strength"):
        EFFECTS["backlash"].formula().draw(rng, -1.0)
    with pytest.raises(ValueError, match="effect backlash: has no formula magic, expected one of film"):
        EFFECTS["backlash"].formula("magic")
    with pytest.raises(ValueError, match="positive rate"):
        TrueInstruments(0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("form", "limit"), [("bouc_wen", 1.5), ("spencer", 5.0)])
def test_is_fast_enough(form: str, limit: float) -> None:
    motions = [excite(160 / 7)] * 7
    forces(form, {}, motions[:1])
    begin = time.perf_counter()
    forces(form, {}, motions)
    assert time.perf_counter() - begin < 2 * limit  # a loaded machine

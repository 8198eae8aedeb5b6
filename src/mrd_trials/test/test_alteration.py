"""Effects put into recordings: as strong as they should be, and as if the damper had been recorded with them."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_trials.truth import ALTERATIONS, EFFECTS, BenchCommand, MeasuredRun, TrueInstruments, TruePlant, alter, record

STEP = 1 / 8000
RATE = 1000.0
QUIET = replace(TrueInstruments(RATE, False).without_noise(), gain_scatter=0.0, offset_scatter=0.0)

FORMULAS = [(name, formula.id) for name in ALTERATIONS for formula in EFFECTS[name].formulas]

SENSED = (
    "gas_spring",
    "seal_friction",
    "side_load_friction",
    "end_stop",
    "moving_mass",
    "load_cell_drift",
    "force_sensor_lag",
    "channel_delay",
    "channel_crosstalk",
    "orifice_loss",
    "guide_waviness",
    "gain_drift",
    "cell_overload",
)
"""Effects whose alteration of the force is as if the damper had been recorded with them."""


def commands() -> list[BenchCommand]:
    t = np.arange(4 * 8000) * STEP
    position = [0.010 * np.sin(2 * np.pi * frequency * t) for frequency in (0.5, 2.0)]
    return [
        BenchCommand(t, motion, np.full_like(t, level), exact=True)
        for motion, level in zip(position, (0.3, 0.1), strict=True)
    ]


def recorded(effects=None, formulas=None):
    """Runs of a simulated damper, recorded without noise."""
    readings = record(
        TruePlant("dahl", {"offset": 0.0}, effects or {}, formulas or {}), commands(), QUIET, np.random.default_rng(0)
    )
    return [
        MeasuredRun(run.time, run.position, np.gradient(run.position, run.time), run.acceleration, run.current, run.force)
        for run in readings
    ]


@pytest.fixture(scope="module")
def measured():
    return recorded()


def typical(effect, formula, strength=1.0):
    return {effect: EFFECTS[effect].formula(formula).draw(np.random.default_rng(3), strength)}


def change(measured, effect, formula, strength):
    """Root mean square of what changes in each channel, over its standard deviation."""
    altered = alter(measured, typical(effect, formula, strength), {effect: formula}, np.random.default_rng(5))
    return np.array(
        [
            np.sqrt(
                np.mean(
                    np.concatenate(
                        [
                            getattr(one, name) - getattr(run, name)[one.recorded]
                            for one, run in zip(altered, measured, strict=True)
                        ]
                    )
                    ** 2
                )
            )
            for name in ("position", "current", "force")
        ]
    )


@pytest.mark.parametrize(("effect", "formula"), FORMULAS)
def test_an_alteration_is_none_without_strength_and_grows_with_it(measured, effect, formula):
    none, weak, strong = (change(measured, effect, formula, strength) for strength in (0.0, 0.5, 2.0))
    np.testing.assert_allclose(none, 0.0, atol=1e-9)
    assert np.all(weak <= strong)
    assert np.all(np.isfinite(strong))
    assert strong[0] > 1e-6 or strong[1] > 1e-3 or strong[2] > 0.05


@pytest.mark.parametrize("effect", SENSED)
def test_a_recording_is_altered_as_if_the_damper_had_the_effect(measured, effect):
    for formula in EFFECTS[effect].formulas:
        effects, formulas = typical(effect, formula.id), {effect: formula.id}
        altered = np.concatenate([one.force for one in alter(measured, effects, formulas, np.random.default_rng(0))])
        with_effect, without = (
            np.concatenate([run.force for run in runs]) for runs in (recorded(effects, formulas), measured)
        )
        difference, size = np.std(altered - with_effect), np.std(with_effect - without)
        assert difference < 0.1 * size + 0.05, formula.id


def test_what_is_in_series_lengthens_the_recorded_motion(measured):
    for effect, formula, shape in (
        ("series_compliance", "kelvin", {"creep_time": 1e-6}),
        ("series_compliance", "rubber", {"hardening_force": 1e6}),
    ):
        altered = alter(measured, {effect: {"compliance": 1e-6, **shape}}, {effect: formula}, np.random.default_rng(0))
        for one, run in zip(altered, measured, strict=True):
            np.testing.assert_allclose(one.position - run.position, 1e-6 * run.force, atol=2e-6)
            np.testing.assert_allclose(one.force, run.force, atol=1e-9)
    backlash, _ = alter(measured, {"backlash": {"play": 4e-4, "drag": 10.0}}, {}, np.random.default_rng(0))
    away = np.abs(backlash.force) > 100.0
    moved = backlash.position - measured[0].position[backlash.recorded]
    np.testing.assert_allclose(moved[away], 2e-4 * np.sign(backlash.force[away]), atol=2e-5)


@pytest.mark.parametrize("effect", ["backlash", "joint_play"])
def test_a_play_is_crossed_at_the_speed_of_the_drive_while_the_rod_rests(measured, effect):
    for formula in EFFECTS[effect].formulas:
        effects, formulas = typical(effect, formula.id), {effect: formula.id}
        altered = alter(measured, effects, formulas, np.random.default_rng(0))
        assert len(altered[0].time) > 4 * RATE + 100
        for one, run in zip(altered, measured, strict=True):
            fastest = np.abs(np.diff(run.position)).max()
            assert np.abs(np.diff(one.position)).max() < 2.0 * fastest
            np.testing.assert_allclose(np.diff(one.time), 1.0 / RATE, rtol=1e-6)
        # A damper with the play, driven as the altered recording says, has the altered force.
        with_play, without = (again(altered, *plant) for plant in ((effects, formulas), ({}, {})))
        for one, run, other in zip(altered, with_play, without, strict=True):
            counted = slice(100, len(run.force))  # the plant starts with no force
            difference, size = (np.std((force[: len(run.force)] - run.force)[counted]) for force in (one.force, other.force))
            assert difference < 0.1 * size + 1.0, formula.id


def again(runs, effects, formulas):
    plant = TruePlant("dahl", {"offset": 0.0}, effects, formulas)
    return record(plant, [driven(run) for run in runs], QUIET, np.random.default_rng(0))


def driven(run):
    t = np.arange(int(8000 * run.time[-1])) * STEP
    return BenchCommand(t, np.interp(t, run.time, run.position), np.full_like(t, run.current[0]), exact=True)


@pytest.mark.parametrize(("effect", "formula"), FORMULAS)
def test_positions_count_from_the_middle_of_the_strokes_wherever_the_recordings_have_their_zero(measured, effect, formula):
    """Once, end stops acted on one side only, and the curve of a transducer began where no reading belongs to a position."""
    moved = [replace(run, position=run.position + 0.045) for run in measured]
    effects, formulas = typical(effect, formula), {effect: formula}
    here, there = (alter(runs, effects, formulas, np.random.default_rng(0)) for runs in (measured, moved))
    for one, other in zip(here, there, strict=True):
        np.testing.assert_allclose(other.position - one.position, 0.045, atol=1e-9)
        np.testing.assert_allclose(other.force, one.force, atol=1e-6)


def test_heat_and_travel_carry_over_from_run_to_run(measured):
    for effect, least in (("settling", 10.0), ("thermal_fade", 0.3)):
        first, second = alter([measured[0]] * 2, typical(effect, ""), {}, np.random.default_rng(0))
        assert np.abs(second.force - first.force).max() > least


def test_what_cannot_be_put_into_a_recording_is_refused(measured):
    with pytest.raises(ValueError, match="effect coil_lag: cannot be put into a recording"):
        alter(measured, typical("coil_lag", ""), {}, np.random.default_rng(0))
    with pytest.raises(ValueError, match="effect channel_delay: has parameters none"):
        alter(measured, {"channel_delay": {}}, {}, np.random.default_rng(0))


def test_enough_effects_can_be_put_into_a_recording():
    assert sum(EFFECTS[name].in_catalogue for name in ALTERATIONS) >= 12

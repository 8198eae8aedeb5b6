"""A plant of another size is the reference plant in other units, and is scored as that."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trials.bench_session import BenchSession
from mrd_trials.cli.make import work
from mrd_trials.closure import ClosureMeter
from mrd_trials.excitation import FRESH_RUNS, command, parse_tier, recommended_command
from mrd_trials.make import make_plant
from mrd_trials.records import GapBin
from mrd_trials.size import CURRENTS, FORCES, STROKES, Size, draw_size, measured_size
from mrd_trials.start import begin_later
from mrd_trials.submission import diagnose_plant
from mrd_trials.trial_design import PlantDesign, Recipe, design_trial
from mrd_trials.trial_folder import PublicPlant, read_trial
from mrd_trials.true_map import true_map

CHANNELS = ("position", "velocity", "acceleration", "current", "force")
SIZE = Size(240.0, 0.035, 6.5)
DESIGN = PlantDesign("p0001", "single", parse_tier("sine@100"), (5, 0, 1), "dahl", ("moving_mass",), (5.0,))


@pytest.fixture(scope="module")
def reference():
    return make_plant(DESIGN)


@pytest.fixture(scope="module")
def scaled():
    return make_plant(replace(DESIGN, size=SIZE))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("", 1.0),
        ("N s/m", 100.0),
        ("N s/m/A", 100.0 / 3.0),
        ("A/m/A", 0.05),
        ("m/(N s)", 0.01),
        ("N/A²", 2000.0 / 9.0),
        ("1/J", 1 / 40_000.0),
        ("Pa s", 5.0),
        ("Hz", 1.0),
    ],
)
def test_a_quantity_grows_by_the_factors_of_its_unit(unit, factor):
    assert Size(2000.0, 20.0, 3.0).factor(unit) == pytest.approx(factor)


@pytest.mark.parametrize("unit", ["V", "N*m"])
def test_an_unknown_unit_is_refused(unit):
    with pytest.raises(InputError, match="unit"):
        SIZE.factor(unit)


def test_every_parameter_of_models_and_effects_has_a_known_unit():
    from mrd_sim.effects import EFFECTS
    from mrd_sim.models import MODELS

    for known in (*MODELS.values(), *EFFECTS.values()):
        for parameter in known.parameters:
            assert Size(1.0, 1.0, 1.0).factor(parameter.unit) == 1.0


def test_a_plant_of_another_size_is_the_reference_plant_in_other_units(reference, scaled):
    of_reference, of_other = ({run.name: run for run in plant[1]} for plant in (reference, scaled))
    assert of_other.keys() == of_reference.keys()
    factors = dict(zip(CHANNELS, (SIZE.motion, SIZE.motion, SIZE.motion, SIZE.current, SIZE.force), strict=True))
    for name, run in of_other.items():
        assert np.array_equal(run.time, of_reference[name].time)
        for channel, factor in factors.items():
            expected = factor * getattr(of_reference[name], channel)
            np.testing.assert_allclose(getattr(run, channel), expected, rtol=1e-14, atol=0.0)


def test_the_answer_has_the_same_plant_and_its_sizes_in_the_units_of_the_plant(reference, scaled):
    (truth, *_), (of_other, *_) = reference, scaled
    assert of_other.size == asdict(SIZE)
    mass = of_other.sizes["moving_mass.mass"]
    assert mass == pytest.approx(truth.sizes["moving_mass.mass"] * SIZE.force / SIZE.motion, rel=1e-12)
    assert replace(of_other, size=truth.size, sizes=truth.sizes, salt=truth.salt) == truth


def test_a_submission_on_a_plant_of_another_size_is_scored_as_on_the_reference_plant(reference, scaled):
    """Closure and map are computed with the parameters and the bins of the submission, which have the size of the plant."""
    model = find_model("bouc_wen", effects=["moving_mass"])
    parameters = {"yield_force": 150.0, "viscous": 900.0, "moving_mass.mass": 1.4}
    session = BenchSession.from_design(DESIGN)
    units = {parameter.name: parameter.unit for parameter in model.parameters}
    complete = {parameter.name: parameters.get(parameter.name, parameter.default) for parameter in model.parameters}
    axes = {"position": "m", "velocity": "m/s", "acceleration": "m/s²", "current": "A", "reversal": "m", "frequency": "Hz"}
    axes |= {"end": "m", "step": "s"}
    closures, maps = [], []
    for (truth, runs, _), size in ((reference, Size()), (scaled, SIZE)):
        given, fresh = runs[:-FRESH_RUNS], runs[-FRESH_RUNS:]
        meter = ClosureMeter.from_session(session, truth.effects, "bouc_wen", given, fresh, size)
        submitted = {name: value * size.factor(units[name]) for name, value in complete.items()}
        closures.append([on(["moving_mass"], submitted) for on in (meter.on_given_runs, meter.on_fresh_runs)])
        ends = ((0.0, 1e-3), (1e-3, 3e-2), (3e-2, 10.0))
        bins = [
            GapBin(axis, low * size.factor(unit), high * size.factor(unit), 0.0)
            for axis, unit in axes.items()
            for low, high in ends
        ]
        maps.append([entry.share for entry in true_map(session, truth.effects, "bouc_wen", bins, size)])
    assert closures[1] == pytest.approx(closures[0], rel=1e-6)
    assert maps[1] == pytest.approx(maps[0], abs=1e-9)
    assert np.ptp(maps[0]) > 0.1


def test_the_diagnosis_is_told_the_limits_of_a_bench_of_this_size():
    given = {}

    def method(runs, model, **options):
        given.update(options)
        raise InputError("enough")

    assert diagnose_plant(PublicPlant("p", "bouc_wen", "sine", 100.0, (), "", size=SIZE), [], method=method).failure
    shipped = Size().bench
    assert given["bench"].limits.reach == pytest.approx(SIZE.motion * shipped.limits.reach)
    speed, current = 0.1, 0.3
    force = given["bench"].force_envelope.force(speed * SIZE.motion, current * SIZE.current)
    assert force == pytest.approx(SIZE.force * shipped.force_envelope.force(speed, current))


def test_a_recommended_experiment_is_brought_to_the_reference_size():
    text = "name: next\nduration_s: 3\nrate_hz: 200\nrod: {{waveform: sine, amplitude_mm: {}, frequency_hz: 1}}\n"
    text += "coil: {{waveform: constant, level_mA: {}}}\n"
    bench = Size().bench
    same = command(plan(parse_experiment(text.format(10.0, 200.0), "next"), bench.limits, bench.force_envelope))
    found = recommended_command(text.format(10.0 * SIZE.motion, 200.0 * SIZE.current), SIZE)
    np.testing.assert_allclose(found.position, same.position, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.current, same.current, rtol=1e-9)


def test_sizes_are_drawn_from_their_ranges_and_change_nothing_else():
    recipe = Recipe(1, {"rich@500": 200})
    designs, _ = design_trial(recipe)
    of_reference, _ = design_trial(replace(recipe, sizes="reference", starts="rest"))
    assert [replace(design, size=None, start_seed=None) for design in designs] == of_reference
    for factors, reference, (low, high) in (
        ([design.size.force for design in designs], 1e3, FORCES),
        ([design.size.motion for design in designs], 0.055, STROKES),
        ([design.size.current for design in designs], 0.5, CURRENTS),
    ):
        values = reference * np.array(factors)
        assert low <= values.min() <= low * (high / low) ** 0.05
        assert high >= values.max() >= high * (low / high) ** 0.05
        assert abs(np.mean(np.log(values / low)) / np.log(high / low) - 0.5) < 0.1
    assert 70 < sum(design.start_seed is not None for design in designs) < 130


def test_a_measured_damper_is_brought_to_the_reference_size():
    time = np.arange(100) / 100.0
    position, force = 0.2 * np.sin(6.0 * time), 30e3 * np.cos(6.0 * time)
    run = Run("a", time, position, np.gradient(position, time), np.zeros(100), force)
    size = measured_size([run])
    brought = size.inverse.scaled(run)
    assert np.abs(brought.force).max() == pytest.approx(1e3)
    assert np.ptp(brought.position) == pytest.approx(0.9 * 0.055)
    assert size.current == 1.0


def test_runs_that_begin_later_lose_their_start_and_nothing_else():
    time = np.arange(2000) / 100.0
    columns = [np.random.default_rng(k).normal(size=len(time)) for k in range(4)]
    runs = [Run(name, time, *columns) for name in "abcdef"] + [Run("short", time[:100], *(c[:100] for c in columns))]
    assert begin_later(runs, None) == runs
    later = begin_later(runs, 7)
    cuts = [run.duration - after.duration for run, after in zip(runs, later, strict=True)]
    assert all(0.3 <= cut <= 2.21 for cut in cuts[:-1])
    assert len(set(cuts)) == len(cuts)
    assert cuts[-1] <= 0.26
    for run, after in zip(runs, later, strict=True):
        assert after.time[0] == 0.0
        for channel in ("position", "velocity", "current", "force"):
            assert np.array_equal(getattr(after, channel), getattr(run, channel)[-len(after) :])


def test_a_session_that_begins_in_motion_has_the_same_noise():
    at_rest, in_motion = (BenchSession.from_design(replace(DESIGN, start_seed=seed)) for seed in (None, 3))
    for whole, cut in zip(at_rest.all_runs({}), in_motion.all_runs({}), strict=True):
        assert 0.29 < whole.duration - cut.duration < 2.22
        assert np.array_equal(cut.force, whole.force[-len(cut) :])
    given, every = in_motion.given_runs({}), in_motion.all_runs({})
    assert all(np.array_equal(one.force, other.force) for one, other in zip(given, every, strict=False))


def test_the_trial_says_its_sizes(tmp_path, monkeypatch):
    arguments = ["--seed", "1", "--plants", "sine@100=1", "--shares", "null=1", "--workers", "1"]
    for sizes, options in (("drawn", []), ("reference", ["--sizes", "reference", "--starts", "rest"])):
        folder = tmp_path / sizes
        monkeypatch.setattr("sys.argv", ["make", str(folder), *arguments, *options])
        work()
        trial = read_trial(folder)
        assert trial.recipe.sizes == sizes
        assert (trial.plants[0].size == Size()) == (sizes == "reference")
    with pytest.raises(InputError, match="sizes tiny: expected one of drawn, reference"):
        design_trial(Recipe(1, {"sine@100": 1}, sizes="tiny"))


def test_drawn_sizes_depend_on_nothing_but_the_generator():
    assert draw_size(np.random.default_rng(3)) == draw_size(np.random.default_rng(3))

"""Causes that hold although the base model has another form than the damper."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_diagnosis import diagnose
from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision import conclusion
from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.fitting.base_fit import FittedBase, fit_base, with_effect
from mrd_diagnosis.fitting.null_distribution import NullGains
from mrd_diagnosis.fitting.refit import refit
from mrd_diagnosis.search import alternative_models
from mrd_diagnosis.search.alternative_models import fit_alternative_models
from mrd_diagnosis.search.model_comparison import compare_on, with_effects
from mrd_diagnosis.wrong_form import form_causes, partial_explanation
from mrd_diagnosis.wrong_form.form_remainder import form_columns, form_effects, with_form_remainder
from mrd_diagnosis.wrong_form.hypotheses import reweighted_gap
from mrd_diagnosis.wrong_form.robustness import is_robust
from mrd_diagnosis.wrong_form.stacking import stacking_weights
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import find_model
from mrd_sim.path import make_path

FORCE_NOISE = 1.5
BOUC_WEN = find_model("bouc_wen")
CANDIDATES = ("moving_mass", "coil_lag", "gas_spring", "shear_thinning", "current_saturation", "settling")


def loop(position, velocity, acceleration, current):
    """Force of a damper that no model of the catalogue describes: a tangent loop over speed and acceleration that bends."""
    yield_force = 40.0 + 420.0 * np.tanh(1.6 * current)
    knee = np.tanh((velocity + 2.5e-3 * np.tanh(acceleration / 0.2)) / (0.008 + 0.01 * current))
    return yield_force * knee + (700.0 + 900.0 * current) * velocity


def runs(effect=lambda signals: 0.0, lag=0.0, seeds=range(5), rate=250.0, seconds=6.0):
    """Record the loop along several motions; ``effect`` adds to its force, ``lag`` in s delays the current that acts."""
    recorded = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        t = np.arange(int(seconds * rate)) / rate
        x, v, a = np.zeros((3, len(t)))
        for amplitude, frequency in ((8e-3, 0.6), (4e-3, 1.7), (2e-3, 4.1)):
            w, phase = 2 * np.pi * frequency, rng.uniform(0, 6)
            x += amplitude * np.sin(w * t + phase)
            v += amplitude * w * np.cos(w * t + phase)
            a -= amplitude * w**2 * np.sin(w * t + phase)
        current = np.repeat(rng.uniform(0, 0.5, 12), len(t) // 12)
        current = np.concatenate([current, np.full(len(t) - len(current), current[-1])])
        acting = current.copy()
        if lag:
            for k in range(1, len(t)):
                acting[k] = current[k] + (acting[k - 1] - current[k]) * np.exp(-1 / (rate * lag))
        force = loop(x, v, a, acting) + effect((t, x, v, a)) + rng.normal(0, FORCE_NOISE, len(t))
        recorded.append(Run(f"run{seed}", t, x, v, current, force))
    return recorded


def late(delay):
    """Record the loop with a force that comes late by ``delay`` s."""
    return [replace(run, force=np.interp(run.time - delay, run.time, run.force)) for run in runs()]


@pytest.fixture(scope="module")
def wrong_form():
    fit = fit_base(BOUC_WEN, None, [prepare_recording(run) for run in runs()], np.random.default_rng(0))
    return fit.weighting, fit.base


@settings(max_examples=20)
@given(scale=st.floats(1e-2, 1e3), seed=st.integers(0, 2**32 - 1))
def test_the_cost_beside_the_remainder_is_the_least_penalised_one(wrong_form, scale, seed):
    weighting, base = wrong_form
    columns = scale * form_columns(weighting.recordings)
    by_run = tuple(np.split(columns, np.cumsum([len(r.force) for r in weighting.recordings])[:-1]))
    problem = replace(weighting, remainder=by_run).problem(base.problem.model, base.theta)
    coefficients = problem.coefficients(base.theta)

    def penalised(values):
        errors = problem.whitened(problem.errors(base.theta)) + problem.white_remainder @ values
        return float(errors @ errors + values @ values)

    least = penalised(coefficients)
    residuals = problem.residuals(base.theta)
    assert float(residuals @ residuals) == pytest.approx(least, rel=1e-6)
    shifted = coefficients + 0.1 * np.random.default_rng(seed).normal(0, 1, len(coefficients))
    assert penalised(shifted) > least


def test_the_remainder_takes_up_what_the_form_lacks_and_nothing_else(wrong_form):
    weighting, base = wrong_form
    extended, beside = with_form_remainder(weighting, base)
    assert beside.chi_square < 0.2 * base.chi_square
    of_form = form_effects(extended, beside, CANDIDATES)
    assert {"shear_thinning", "current_saturation"} <= set(of_form)
    assert {"moving_mass", "coil_lag", "settling"}.isdisjoint(of_form)


@pytest.mark.parametrize(
    ("cause", "recorded"),
    [
        ("moving_mass", {"effect": lambda signals: 4.0 * signals[3]}),
        pytest.param("coil_lag", {"lag": 0.012}, marks=pytest.mark.slow),
    ],
)
def test_a_cause_is_named_although_the_damper_has_another_form(cause, recorded, monkeypatch):
    size, *others = EFFECTS[cause].parameters
    wide = replace(size, lower=10 * size.lower, upper=10 * size.upper)
    # At the limit of its range, it would be seen, but not named.
    monkeypatch.setitem(EFFECTS, cause, replace(EFFECTS[cause], parameters=(wide, *others)))
    diagnosis = diagnose(runs(**recorded), "bouc_wen", effects=CANDIDATES)
    assert diagnosis.verdict == "partly_explained"
    assert [named.effect for named in diagnosis.causes] == [cause]
    assert diagnosis.causes[0].probability > 0.55
    assert diagnosis.gap.form_fraction > 0.05
    assert diagnosis.sentence


def test_a_spring_that_hardens_is_not_surely_an_end_stop():
    springs = ("end_stop", "hardening_spring")
    recorded = runs(effect=lambda signals: 60.0 * (signals[1] / 8e-3) ** 3)
    diagnosis = diagnose(recorded, "hyperbolic_tangent", effects=(*CANDIDATES, *springs))
    (cause,), (alternative,) = diagnosis.causes, diagnosis.alternatives
    assert {cause.effect, alternative.effect} == set(springs)
    assert cause.probability < 0.9


def sines(play, seed=3, rate=250.0, fine=8):
    """Record the loop along sines of one speed, three strokes and three currents, behind a play in m."""
    rng, recorded, top_speed = np.random.default_rng(seed), [], 0.048
    t = np.arange(int(6.0 * rate * fine)) / (rate * fine)
    for number, (level, w) in enumerate(((0.1, 6.0), (0.25, 12.0), (0.4, 4.0))):
        x, v = top_speed / w * np.sin(w * t), top_speed * np.cos(w * t)
        moved = x.copy()
        for k in range(1, len(t)):
            moved[k] = np.clip(moved[k - 1], x[k] - play / 2, x[k] + play / 2)
        force = loop(moved, np.gradient(moved, t), -(w**2) * moved, level)
        t_s, x_s, v_s, force_s = (series[::fine] for series in (t, x, v, force))
        noise = rng.normal(0, FORCE_NOISE, len(t_s))
        recorded.append(Run(f"sine{number}", t_s, x_s, v_s, np.full(len(t_s), level), force_s + noise))
    return recorded


@pytest.mark.parametrize(("play", "named"), [(6e-4, True), pytest.param(0.0, False, marks=pytest.mark.slow)])
def test_at_one_speed_a_cause_is_named_beside_a_wrong_form(play, named):
    """A play, of a joint or of the drive: these sines do not tell which."""
    diagnosis = diagnose(sines(play), "bouc_wen", effects=(*CANDIDATES, "channel_delay", "joint_play", "backlash"))
    assert len(diagnosis.causes) == named
    if named:
        (cause,) = diagnosis.causes
        assert diagnosis.verdict == "partly_explained"
        assert cause.effect in ("joint_play", "backlash")
        # A damper model of another form takes up a part of the play.
        assert cause.parameters[f"{cause.effect}.play"].value.value == pytest.approx(play, rel=0.3)


@pytest.fixture(scope="module")
def around_own_curve():
    """Sines with a play, and the fit of the damper's own curve to them."""
    recordings = [prepare_recording(run) for run in sines(6e-4)]
    fit = fit_base(find_model("hyperbolic_tangent"), None, recordings, np.random.default_rng(0))
    weighting, base = fit.weighting, fit.base
    return compare_on(weighting, base, [], []), base


def test_the_likeness_of_a_cause_of_the_form_is_weighed_against_it(around_own_curve):
    """Around the damper's own curve, a play of either kind closes most of the gap, that of the drive somewhat more."""
    (comparison, base), plays = around_own_curve, ("backlash", "joint_play")
    reachable = 0.2 * base.held_out_cost

    def causes_of(effects):
        rest = [], NullGains(np.zeros(9), 1.0), np.random.default_rng(0)
        return form_causes.name_form_causes(comparison, base, reachable, effects, plays, *rest)[0]

    (cause,) = causes_of(["backlash"]).values()
    assert 0.8 < cause.probabilities["backlash"] < 0.99
    assert sum(cause.probabilities.values()) == pytest.approx(1.0)
    assert causes_of(["joint_play"]) == {}


def test_of_two_effects_of_the_form_one_alone_must_close_most_of_what_can_be_closed(around_own_curve, monkeypatch):
    """The chain closes most with its second effect. Where that one does not hold, the first is named if it does alone."""
    comparison, base = around_own_curve
    (first,) = form_causes._form_chain(comparison.weighting, base, 0.2 * base.held_out_cost, ["backlash"])
    superfluous = with_effects(comparison.weighting, first, ["channel_delay"], {})
    superfluous = replace(superfluous, held_out_squares=first.held_out_squares + 1.0)
    monkeypatch.setattr(form_causes, "_form_chain", lambda *_: [first, superfluous])
    closed = base.held_out_cost - first.held_out_cost

    def causes_of(reachable):
        rest = [], [], NullGains(np.zeros(9), 1.0), np.random.default_rng(0)
        return form_causes.name_form_causes(comparison, base, reachable, ["backlash", "channel_delay"], *rest)

    causes, explained = causes_of(base.held_out_cost - closed / 0.9)
    assert list(causes) == ["backlash"]
    assert explained is first
    assert causes_of(base.held_out_cost - closed / 0.6) == ({}, base)


@pytest.mark.parametrize(
    ("costs", "harmful"),
    [
        ({"": 1.0, "a": 0.9, "b": 2.0}, {"a"}),
        ({"": 1.0, "a": 0.9, "b": 0.8}, {"b"}),
        ({"": 1.0, "a": 1.1, "b": 1.2}, set()),
        ({"": 1.0, "a": 0.9, "b": 0.8, "c": 2.0, "ab": 0.7, "bc": 2.5}, {"a", "b"}),
        ({"": 1.0, "a": 0.9, "b": 0.8, "c": 2.0, "ab": 0.9, "bc": 2.5}, {"b"}),
    ],
)
def test_what_harms_the_prediction_beside_the_others_is_left_out_one_after_the_other(
    around_own_curve, monkeypatch, costs, harmful
):
    """Costs are those without the effects, as shares of the gap."""
    comparison, base = around_own_curve
    weighting = comparison.weighting
    gap = base.held_out_squares - sum(np.sum(noise.sigma**2) for noise in weighting.noise) / len(base.held_out_squares)

    def without(effects):
        return replace(base, held_out_squares=costs["".join(sorted(effects))] * gap)

    left_out = {id(best := without("")): ""}

    def refit_without(_weighting, refitted, effect):
        found = without(left_out[id(refitted)] + effect)
        left_out[id(found)] = left_out[id(refitted)] + effect
        return found

    monkeypatch.setattr(conclusion, "refit_on", lambda _weighting, refitted: refitted)
    monkeypatch.setattr(conclusion, "refit_without", refit_without)
    effects = tuple(sorted(set("".join(costs))))
    chosen = replace(comparison, effects=effects, chain=(best,) * len(effects))
    assert set(conclusion.harmful_effects(chosen, np.random.default_rng(0))[0]) == harmful


@pytest.mark.parametrize("diverged", [np.inf, np.nan])
def test_an_effect_with_which_a_fit_diverges_in_every_fold_closes_nothing(around_own_curve, diverged):
    comparison, base = around_own_curve
    with_effect = replace(base, held_out_squares=np.full_like(base.held_out_squares, diverged))
    closed = closed_fraction_between(base, with_effect, comparison, np.random.default_rng(0))
    assert (closed.value, closed.lower, closed.upper) == (-1.0, -1.0, -1.0)


def test_an_effect_of_the_form_is_judged_beside_the_others(monkeypatch):
    """A damper that leaks and thins: a model that leaks predicts worse than both."""
    both = ("bypass_flow", "shear_thinning")
    typical = {f"{effect}.{name}": value for effect in both for name, value in EFFECTS[effect].typical.items()}
    model = BOUC_WEN.with_effects(find_effects(both))
    theta = model.vector(typical | {"coil_lag": 0.0})
    recorded = []
    for seed, run in enumerate(runs()):
        path = make_path(run.time, run.position, run.velocity, np.gradient(run.velocity, run.time), run.current)
        noise = np.random.default_rng(seed).normal(0, FORCE_NOISE, len(run.time))
        recorded.append(prepare_recording(replace(run, force=model.force(theta, path) + noise)))
    fit = fit_base(BOUC_WEN, None, recorded, np.random.default_rng(0))
    weighting, base = fit.weighting, fit.base
    complete = with_effects(weighting, base, both, typical)
    thinning = with_effects(weighting, base, ["shear_thinning"], typical)
    leaking = replace(thinning, held_out_costs=2.0 * thinning.held_out_costs)
    monkeypatch.setattr(form_causes, "contains", lambda _model, effect: effect == "bypass_flow")
    beside = []
    monkeypatch.setattr(
        form_causes, "with_effects", lambda _weighting, form, effects, _values: beside.append(effects) or form
    )
    monkeypatch.setattr(form_causes, "_form_chain", lambda *_: [thinning, complete])
    causes, explained = form_causes.name_form_causes(
        compare_on(weighting, base, [], []),
        base,
        complete.held_out_cost,
        both,
        both,
        [leaking],
        NullGains(np.zeros(9), 1.0),
        np.random.default_rng(0),
    )
    assert set(causes) == set(both)
    assert explained is complete
    assert beside == [("bypass_flow",)]


def test_without_candidates_no_effect_is_tried_again(wrong_form, monkeypatch):
    """Along a single stroke there are none, but what the search had chosen was tried around the user's model once more."""
    weighting, base = wrong_form
    with_thinning = with_effects(weighting, base, ["shear_thinning"], {})
    comparison = replace(compare_on(weighting, base, [], []), effects=("shear_thinning",), chain=(with_thinning,))
    others = fit_alternative_models(weighting, base, -np.inf, np.random.default_rng(1))
    tried = []

    def nothing_holds(_comparison, explained, _reachable, effects, *_rest, **_options):
        tried.append(list(effects))
        return {}, explained

    monkeypatch.setattr(partial_explanation, "name_form_causes", nothing_holds)
    explanation = Explanation("unknown_effect", comparison, {}, {})
    explained = partial_explanation.explain_in_part(
        explanation, list(others.values()), [], NullGains(np.zeros(9), 1.0), np.random.default_rng(2)
    )
    assert explained.verdict == "unknown_effect"
    assert tried == [[]]


def test_the_best_model_of_the_catalogue_leads_to_the_same_cause():
    diagnosis = diagnose(runs(lag=0.012), "auto", effects=CANDIDATES)
    assert diagnosis.model.id in ("hyperbolic_tangent", "sigmoid", "algebraic")
    assert diagnosis.notes[0].startswith("Of the damper models that were tried")
    assert [named.effect for named in diagnosis.causes] == ["coil_lag"]
    assert diagnosis.causes[0].probability > 0.7


def test_no_model_is_chosen_for_a_freedom_that_it_will_not_have(wrong_form, monkeypatch):
    """It was chosen with its exponent fitted too, and the diagnosis went on with the usual one."""
    weighting, base = wrong_form
    monkeypatch.setattr(alternative_models, "fit_base", lambda *_arguments: FittedBase(weighting, base, [], []))
    freed = weighting.problem(base.problem.model, base.theta, ("exponent",))
    better = replace(base, problem=freed, held_out_costs=0.5 * base.held_out_costs)
    model = find_model("modified_dahl")
    other = replace(base, problem=weighting.problem(model, model.defaults), held_out_costs=0.8 * base.held_out_costs)
    monkeypatch.setattr(alternative_models, "fit_alternative_models", lambda *_: {"freed": better, "other": other})
    assert alternative_models.best_model(BOUC_WEN, [], np.random.default_rng(0)).id == "modified_dahl"


def test_models_are_weighted_by_what_they_add_to_the_prediction(wrong_form):
    weighting, base = wrong_form
    twin = replace(base, theta=base.theta.copy())
    others = fit_alternative_models(weighting, base, -np.inf, np.random.default_rng(1))
    weights = stacking_weights([base, twin, *others.values()])
    assert weights.sum() == pytest.approx(1.0)
    assert (weights >= 0.0).all()
    # The damper's own curve is a hyperbolic tangent of speed.
    assert weights[2 + list(others).index("hyperbolic_tangent")] > 0.9
    assert stacking_weights([base, twin]) == pytest.approx([0.5, 0.5], abs=1e-3)


def test_a_form_keeps_the_values_of_an_effect_that_no_other_form_has(wrong_form):
    """A model that lacks a hysteretic state is one of the forms with its effect; the values came from another form."""
    weighting, base = wrong_form
    model, theta = with_effect(base.problem.model, base.theta, "moving_mass")
    form = refit(weighting.problem(model, theta), theta, weighting.folds)
    both = with_effects(weighting, form, ["gas_spring"], {"gas_spring.stiffness": 500.0})
    assert both.effects == ("gas_spring", "moving_mass")


def test_another_form_alone_is_no_effect():
    diagnosis = diagnose(runs(), "bouc_wen", effects=CANDIDATES)
    assert diagnosis.verdict == "unknown_effect"
    assert diagnosis.causes == ()
    assert diagnosis.gap.form_fraction > 0.8


@pytest.mark.parametrize(
    ("probability", "gains", "named"),
    [
        (0.95, (1.0, 2.0, 1.5), True),
        (0.9, (9.0, 20.0, -7.0, 0.3), True),
        (0.07, (1.0, 2.0, 1.5), False),  # around the other damper models, it does nothing
        (0.78, (900.0, -2.0, 1.5, -0.1), False),  # one fold alone speaks for it
        (0.95, (-1.0, -2.0), False),
    ],
)
def test_what_is_unlikely_or_shows_in_one_fold_alone_is_not_named(wrong_form, probability, gains, named):
    _, base = wrong_form
    without, with_effect = (replace(base, held_out_squares=np.array(squares)) for squares in (gains, np.zeros(len(gains))))
    assert is_robust(probability, without, with_effect) is named


def growing_play(current):
    """Return the current that acts behind an iron whose loop is the wider, the larger the current is."""
    acting, state = np.empty_like(current), current[0]
    for k, value in enumerate(current):
        width = 0.02 + 0.1 * value
        state = min(max(state, value - width), value + width)
        acting[k] = 0.6 * state + 0.4 * value
    return acting


def with_formula_of_its_own(effect):
    """Record a damper of the base's form with an effect whose formula is not that of the catalogue."""
    theta, cap = BOUC_WEN.vector({"coil_lag": 0.0}), BOUC_WEN.with_effects(find_effects(["cavitation"]))
    values = [EFFECTS["cavitation"].typical.get(p.name, p.default) for p in EFFECTS["cavitation"].parameters]
    recorded = []
    for run in runs():
        motion = run.position, run.velocity, np.gradient(run.velocity, run.time)
        acting = growing_play(run.current) if effect == "magnetic_hysteresis" else run.current
        path = make_path(run.time, *motion, acting)
        force = BOUC_WEN.force(theta, path)
        if effect == "side_load_friction":
            force += 2e5 * run.position**2 * np.tanh(run.velocity / 4e-3)
        if effect == "cavitation":  # in one of two chambers
            force = 0.4 * force + 0.6 * cap.force(np.append(theta, values), path)
        recorded.append(replace(run, force=force + np.random.default_rng(1).normal(0, FORCE_NOISE, len(force))))
    return recorded


@pytest.mark.parametrize(
    "effect",
    ["magnetic_hysteresis", *(pytest.param(name, marks=pytest.mark.slow) for name in ("side_load_friction", "cavitation"))],
)
def test_an_effect_with_another_formula_is_named_though_it_does_not_close_the_gap(effect):
    diagnosis = diagnose(
        with_formula_of_its_own(effect),
        "bouc_wen",
        effects=(*CANDIDATES, "magnetic_hysteresis", "side_load_friction", "cavitation", "seal_friction", "flow_asymmetry"),
    )
    assert diagnosis.verdict == "partly_explained"
    assert [cause.effect for cause in diagnosis.causes] == [effect]
    assert 0.2 < diagnosis.gap.closed_fraction.value < 0.95


@given(st.floats(1.0, 1e9), st.lists(st.tuples(st.floats(0.01, 0.9), st.floats(0.5, 5.0)), min_size=1, max_size=3))
def test_shares_of_effects_beside_others_are_those_of_the_whole_gap(gap, steps):
    """Each step closes a share of what is left, and then the weighting changes by a factor."""
    reweighted, left, factors = gap, gap, 1.0
    for share, factor in steps:
        left_before = left * (1.0 - share)
        left = left_before * factor
        reweighted, factors = reweighted_gap(reweighted, left_before, left), factors * factor
        assert reweighted == pytest.approx(gap * factors)

"""A diagnosis as gap_report.json, as a page, and as a sentence."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_base.json_file import read_schema
from mrd_diagnosis.cli.diagnose import print_summary
from mrd_diagnosis.decision.candidates import list_alternatives
from mrd_diagnosis.diagnosis import (
    ON_BOUND,
    UNDETERMINED,
    Advice,
    Alternative,
    AlternativeModel,
    Candidate,
    Cause,
    CorrectedSimulator,
    Diagnosis,
    Finding,
    Gap,
    Interval,
    Member,
    ParameterEstimate,
    Region,
    Rejected,
    RunNoise,
    RunResidual,
    UntestableEffect,
)
from mrd_diagnosis.evidence.detectability import clause_of_size
from mrd_diagnosis.fitting.null_distribution import REALISATIONS, NullGains
from mrd_diagnosis.localisation.localise import localise
from mrd_diagnosis.recordings.closed_loop import closed_loop_notes
from mrd_diagnosis.report import figures
from mrd_diagnosis.report.candidate_text import describe_candidate, ordered_candidates
from mrd_diagnosis.report.gap_file import read_gap_report, to_json
from mrd_diagnosis.report.page import page_content, significant_regions, write_gap_report
from mrd_diagnosis.report.sentences import corrected_label, next_command, next_step, verdict_sentence
from mrd_diagnosis.wording.effect_names import effect_clause
from mrd_diagnosis.wording.quantities import format_error, format_p_value, format_probability, format_quantity, format_share
from mrd_identification.correction import correction_of_report
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import Problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS, load_effects
from mrd_sim.models import find_model
from mrd_sim.path import make_path

NOISE = 3.0
NAN = Interval(float("nan"))
VERDICTS = ("data_fault", "no_gap", "explained", "ambiguous", "partly_explained", "unknown_effect")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
EXPERIMENT = """\
name: current_steps
description: constant speed under steps of the coil current
duration_s: 20.0
rate_hz: 1000.0
transition: quintic
rod: {waveform: triangle, amplitude_mm: 10.0, frequency_hz: 1.0}
coil: {waveform: aprbs, low_mA: 0.0, high_mA: 400.0, shortest_s: 0.05, longest_s: 0.5, count: 8, seed: 1}
"""


def simulated(seed, effects):
    """Simulate a Bouc-Wen damper with ``effects`` along a multisine under steps of current, with noise on the force."""
    random = np.random.default_rng(seed)
    time = np.arange(0, 6, 0.004)
    position, velocity, acceleration = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.7, 8e-3), (2.3, 3e-3)):
        w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        position += amplitude * np.sin(w * time + phase)
        velocity += amplitude * w * np.cos(w * time + phase)
        acceleration -= amplitude * w**2 * np.sin(w * time + phase)
    current = random.choice([0.0, 0.2, 0.4], 24).repeat(-(-len(time) // 24))[: len(time)]
    model = find_model("bouc_wen", effects=list(effects))
    sizes = {f"{effect}.{name}": value for effect, values in effects.items() for name, value in values.items()}
    theta = model.vector({"coil_lag": 0.004, **sizes})
    force = model.force(theta, make_path(time, position, velocity, acceleration, current))
    return Run(f"multisine_{seed}", time, position, velocity, current, force + NOISE * random.standard_normal(len(time)))


def fitted(recordings, effects):
    """Return measured minus modelled force of each recording after a refit with ``effects``, and the parameters."""
    model = find_model("bouc_wen", effects=list(effects))
    free = tuple(i for i, p in enumerate(model.parameters) if p.free)
    start = model.vector({f"{name}.{p}": v for name in effects for p, v in EFFECTS[name].typical.items()})
    theta, _ = fit_least_squares(Problem(model, recordings, free, start), start, 20)
    return [r.force - r.modelled(model, theta) for r in recordings], dict(zip(model.names, map(float, theta), strict=True))


def nrmse(recordings, residuals):
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)) / np.std(np.concatenate([r.force for r in recordings])))


def about(value, relative=0.05):
    return Interval(value, value - relative * abs(value), value + relative * abs(value))


def estimates(effect, parameters):
    """Return the fitted parameters of an effect as a diagnosis has them."""
    return {
        f"{effect}.{p.name}": ParameterEstimate(about(parameters[f"{effect}.{p.name}"]), p.unit)
        for p in EFFECTS[effect].parameters
        if f"{effect}.{p.name}" in parameters
    }


def findings_of(verdict):
    findings = [
        Finding("coverage", "remark", "3 runs, 18 s: position −11 to 11 mm, speed up to 78 mm/s, current 0 to 0.4 A"),
        Finding("quantisation", "limitation", "is read in steps of 0.8 N; use a smaller range", "multisine_2", "force"),
    ]
    if verdict == "data_fault":
        findings += [
            Finding("clipping", "fault", "42 samples stay at 981 N; widen the range", "multisine_1", "force"),
            Finding("clock", "fault", "7 % of the samples are missing; record it again", "multisine_3", "time"),
        ]
    return tuple(findings)


@cache
def diagnosed(verdict):
    """Return a diagnosis with this verdict, of runs with a late force channel (none for ``no_gap``).

    For ``partly_explained``, the flow differs with its direction as well.
    """
    effect, findings = "channel_delay", findings_of(verdict)
    effects = {} if verdict == "no_gap" else {effect: {"delay": 0.012}}
    if verdict == "partly_explained":
        effects["flow_asymmetry"] = {"asymmetry": 0.3}
    recordings = [prepare_recording(simulated(k, effects)) for k in (1, 2, 3)]
    common = {
        "model": find_model("bouc_wen"),
        "runs": tuple(recording.run for recording in recordings),
        "held_out": (),
        "seed": 0,
        "elapsed": 9.4,
        "findings": findings,
        "verdict": verdict,
        "held_out_by": "leave-one-run-out",
    }
    if verdict == "data_fault":
        return with_sentence(Diagnosis(**common, sentence=""))
    noise = [RunNoise(np.full(len(r.force), NOISE), NOISE, 0.0, "residual") for r in recordings]
    chosen = {"no_gap": (), "unknown_effect": ("force_sensor_lag",)}.get(verdict, (effect,))
    before, base = fitted(recordings, ())
    after, parameters = fitted(recordings, chosen) if chosen else (before, base)
    floor, first, last = (nrmse(recordings, part) for part in ([n.sigma for n in noise], before, after))
    closed = 1 - (last**2 - floor**2) / (first**2 - floor**2)
    ranked = [*(chosen or ("flow_asymmetry",)), *(n for n in EFFECTS if n not in chosen and n != "flow_asymmetry")]
    candidates = tuple(
        Candidate(
            (name,),
            last,
            about(max(closed - 0.11 * k, 0.02 * (5 - k)), 0.08),
            min(0.005 + 0.05 * k, 1.0),
            (0.9, 0.06, 0.03)[k] if k < 3 else 0.001,
            estimates(name, parameters) if name in chosen else {},
            ("coil_lag",) if k == 0 else (),
            smallest_detectable="" if name in chosen else f"{k} mm",
        )
        for k, name in enumerate(ranked[:15])
    )
    gap = Gap(
        noise_floor=Interval(floor),
        before=about(first, 0.1),
        after=about(last, 0.03),
        closed_fraction=about(closed, 0.04) if chosen else NAN,
        as_given=1.6 * first,
        explainable_fraction=0.64,
        extrapolated=about(0.9 * closed) if chosen else None,
        form_fraction={"partly_explained": 0.08, "unknown_effect": 0.31}.get(verdict, float("nan")),
    )
    remaining = after if verdict == "partly_explained" else before
    where = localise(recordings, noise, remaining)
    named = chosen if verdict in ("explained", "ambiguous", "partly_explained") else ()
    causes = tuple(Cause(name, 0.9, 0.005, about(closed, 0.04), estimates(name, parameters)) for name in named)
    alternatives, advice, models = (), None, ()
    if verdict == "ambiguous":
        lag = {"lag": ParameterEstimate(about(0.009), "s")}
        alternatives = (Alternative("coil_lag", effect, 0.38, "predicts held-out data nearly as well", lag),)
        text = "Steps of the coil current while the rod moves at a constant speed: a lag of the current then shows alone."
        advice = Advice(text, EXPERIMENT, (effect, "coil_lag"), 0.02)
    if verdict == "partly_explained":
        alternatives = (Alternative("coil_lag", effect, 0.07, "predicts held-out data nearly as well"),)
    nearest = candidates[0] if verdict in ("partly_explained", "unknown_effect") else None
    if nearest is not None:
        models = (AlternativeModel("modified_dahl", last, about(0.3), "modified_dahl"),)
    diagnosis = Diagnosis(
        **common,
        sentence="",
        gap=gap,
        corrected=CorrectedSimulator(chosen, parameters),
        where=where,
        causes=causes,
        rejected=tuple(
            Rejected(candidate.effects[0], "little", "it closes next to nothing of the gap", False, 0.001, 0.4, about(0.01))
            for candidate in candidates
            if candidate.effects[0] not in named
        ),
        alternatives=alternatives,
        nearest=nearest,
        candidates=candidates,
        untestable=(
            UntestableEffect("end_stop", "it does not act in these runs"),
            UntestableEffect("load_cell_gain", "the model's own parameters take it up"),
        ),
        alternative_models=models,
        next_experiment=advice,
        residuals=tuple(
            RunResidual(r, n, b, a, 0.8 * k, -0.002 * k, extrapolates="speed, 250 against 180 mm/s" if k == 2 else "")
            for k, (r, n, b, a) in enumerate(zip(recordings, noise, before, after, strict=True))
        ),
        notes=("Only three runs: the intervals are uncertain.",),
    )
    return with_sentence(diagnosis)


def with_sentence(diagnosis, **changes):
    """Return a diagnosis with changes, and with the sentence that follows from them."""
    diagnosis = replace(diagnosis, **changes)
    return replace(diagnosis, sentence=verdict_sentence(diagnosis))


def markup_of(page):
    """A page without its scripts."""
    return re.sub(r"<script.*?</script>", "", page.read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_a_file_and_a_page_that_needs_no_network(verdict, tmp_path):
    diagnosis = diagnosed(verdict)
    path = write_gap_report(diagnosis, tmp_path)
    content = read_gap_report(tmp_path / "gap_report.json")
    assert content["sentence"] == diagnosis.sentence
    assert content["verdict"] == verdict
    assert path.stat().st_size < 1e6
    assert "<script src=" not in path.read_text()
    markup = markup_of(path)
    assert not re.search(r"https?://|\bsrc=|url\((?!#)", markup)
    # Apostrophes are escaped in the page.
    assert diagnosis.sentence.split("'")[0] in markup
    assert ("<svg" in markup) == (verdict != "data_fault")
    for finding in diagnosis.findings:
        assert finding.text in markup
    assert "<footer>" in markup
    if verdict != "data_fault":
        assert re.search(r'aria-label="Chart of held-out error: .*parameters refitted 0\.', markup)


def seen_only():
    """Return a diagnosis in which the effect that closes the gap stands at the limit of its range."""
    diagnosis = diagnosed("ambiguous")
    (cause,) = diagnosis.causes
    parameters = {name: replace(estimate, remark=ON_BOUND) for name, estimate in cause.parameters.items()}
    why = "its size stands at the limit of the plausible range"
    seen = Rejected(cause.effect, "on_bound", why, True, 0.999, 0.005, cause.closed_fraction, parameters)
    changes = {"causes": (), "rejected": (seen,), "alternatives": (), "next_experiment": None}
    return with_sentence(diagnosis, nearest=diagnosis.candidates[0], **changes)


def test_what_is_seen_and_not_determined_has_no_probability_and_nothing_to_apply(tmp_path):
    diagnosis = seen_only()
    page = markup_of(write_gap_report(diagnosis, tmp_path))
    content = read_gap_report(tmp_path / "gap_report.json")
    assert (content["causes"], content["rejected"][0]["rule"]) == ([], "on_bound")
    assert diagnosis.sentence.startswith("Seen, not determined: the force channel is late by 12")
    assert "is not named as a cause: its size stands at the limit of the plausible range." in diagnosis.sentence
    assert "99 %" not in diagnosis.sentence + page
    assert "Seen, but not named as a cause" in page
    assert corrected_label(diagnosis) == "with the nearest effect"
    assert "a wider range" in next_step(diagnosis)
    assert next_command(diagnosis) == ""
    # Where it does not close the whole gap either, it is what the headline says all the same.
    nearest = with_sentence(diagnosis, verdict="unknown_effect", gap=replace(diagnosis.gap, closed_fraction=about(0.6)))
    assert nearest.sentence.startswith("Seen, not determined: the force channel is late by 12")
    assert "It would remove 60 % of the gap" in nearest.sentence
    assert "a wider range" in next_step(nearest)


@pytest.mark.parametrize("verdict", ["explained", "partly_explained"])
@pytest.mark.parametrize("doubt", ["improbable", "not named", "none"])
def test_the_next_command_and_step_agree_with_what_apply_does(verdict, doubt):
    """`apply` refuses what is not proven without --anyway, so the report proposes it with --anyway and says so."""
    diagnosis = replace(diagnosed(verdict), alternative_models=(), findings=())
    (cause,) = diagnosis.causes
    if doubt == "improbable":
        diagnosis = replace(diagnosis, causes=(replace(cause, probability=0.42),))
    if doubt == "not named":
        added = EFFECTS["gas_spring"].typical
        effects = (*diagnosis.corrected.effects, "gas_spring")
        parameters = diagnosis.corrected.parameters | {f"gas_spring.{name}": value for name, value in added.items()}
        diagnosis = replace(diagnosis, corrected=replace(diagnosis.corrected, effects=effects, parameters=parameters))
    command = next_command(diagnosis).splitlines()[-1]
    report = to_json(diagnosis)
    model = AlternativeModel("modified_dahl", 0.01, about(0.9), "modified_dahl")
    steps = [next_step(diagnosis)]
    if verdict == "partly_explained":
        steps.append(next_step(replace(diagnosis, alternative_models=(model,))))
    if doubt == "none":
        assert correction_of_report(report, "gap.json").effects
        assert not any("--anyway" in text or "not proven" in text for text in (command, *steps))
        return
    with pytest.raises(InputError, match="is below 50 %, so it is not proven"):
        correction_of_report(report, "gap.json")
    assert correction_of_report(report, "gap.json", anyway=True).effects
    assert command.endswith(" --anyway")
    assert all("not proven" in step for step in steps)
    # Other tools refuse the report as well; they read what was written from it.
    hybrid = replace(diagnosis.runs[0], info={"source": "bag", "experiment": "name: a\nlaw: skyhook\n"})
    review = next_command(replace(diagnosis, runs=(hybrid, *diagnosis.runs[1:]))).splitlines()[-1]
    assert "review bag --diagnosis CORRECTED.yaml" in review


def test_the_form_comes_first_where_it_is_most_of_the_gap():
    diagnosis = diagnosed("partly_explained")
    model = AlternativeModel("modified_dahl", 0.01, about(0.9), "modified_dahl")
    weak = replace(diagnosis.nearest, closed_fraction=about(0.02))
    gap = replace(diagnosis.gap, closed_fraction=about(0.02), form_fraction=0.93)
    headline = "Most of the gap (93 %) lies in the form of the damper model"
    for verdict, causes in (("partly_explained", diagnosis.causes), ("unknown_effect", ())):
        changed = with_sentence(
            diagnosis, verdict=verdict, causes=causes, gap=gap, nearest=weak, alternative_models=(model,)
        )
        assert changed.sentence.startswith(headline)
        assert "The model modified_dahl removes 90 %: try it next." in changed.sentence
    assert not diagnosis.sentence.startswith("Most of the gap")


def test_a_limitation_that_makes_a_gap_comes_before_an_unknown_effect():
    held = Finding(
        "clock", "limitation", "the position is refreshed at 50 Hz only. Raise the rate of the sensor.", "a", "position"
    )
    diagnosis = with_sentence(diagnosed("unknown_effect"), findings=(held,))
    assert diagnosis.sentence.startswith(
        "A limitation of the recordings makes a gap by itself (run a): the position is refreshed at 50 Hz only."
    )
    assert next_step(diagnosis).startswith("Raise the rate of the sensor.")
    assert next_command(diagnosis) == ""


def test_the_file_says_what_the_contract_says():
    content = to_json(diagnosed("explained"))
    assert [run["name"] for run in content["runs"]["fit"]] == ["multisine_1", "multisine_2", "multisine_3"]
    for name in ("noise_floor", "before", "after", "closed_fraction"):
        assert content["gap"][name].keys() == {"value", "ci95"}
    assert content["gap"]["noise_floor"]["ci95"] == [None, None]
    (cause,) = content["causes"]
    assert (cause["effect"], cause["stage"], cause["parameters"].keys()) == ("channel_delay", "sensing", {"delay"})
    assert cause["parameters"]["delay"]["value"] == pytest.approx(0.012, rel=0.02)
    assert content["gap"]["closed_fraction"]["value"] > 0.95
    assert content["corrected"]["parameters"]["channel_delay.delay"] == pytest.approx(0.012, rel=0.02)
    assert {"axis", "lower", "upper", "unit", "share", "lift", "ci95"} <= content["where"][0].keys()
    assert content["runs"]["fit"][0]["before"] > 5 * content["runs"]["fit"][0]["after"]


def test_the_file_lists_what_is_not_ruled_out():
    content = to_json(diagnosed("explained"))
    assert content["untestable"][0] == {"effect": "end_stop", "why": "it does not act in these runs"}
    assert content["candidates"][2]["smallest_detectable"] == "2 mm"
    assert content["candidates"][0]["indistinguishable"] == ["coil_lag"]
    (model,) = to_json(diagnosed("unknown_effect"))["alternative_models"]
    assert (model["model"], model["closed_fraction"]) == ("modified_dahl", 0.3)
    assert to_json(diagnosed("partly_explained"))["gap"]["form_fraction"] == 0.08
    assert content["gap"]["form_fraction"] is None
    assert model["ci95"] == pytest.approx([0.285, 0.315])


def test_the_page_lists_what_is_not_ruled_out(tmp_path):
    comparison = page_content(diagnosed("ambiguous"))["comparison"]
    effects = [effect for _, effect, _ in comparison["unnoticed"]]
    # Neither the cause nor its alternative is listed.
    assert not {"channel_delay", "coil_lag"}.intersection(effects)
    assert len(effects) == 13
    assert all(smallest.endswith(" mm") for _, _, smallest in comparison["unnoticed"])
    markup = markup_of(write_gap_report(diagnosed("ambiguous"), tmp_path))
    assert "could be present up to this size</th>" in markup
    assert "it does not act in these runs" in markup


@pytest.mark.parametrize(("closed", "has_card"), [(0.4, True), (0.001, False)])
def test_every_effect_that_was_tried_has_a_card_or_a_row(closed, has_card):
    diagnosis = diagnosed("unknown_effect")
    nearest = replace(diagnosis.candidates[0], closed_fraction=about(closed), smallest_detectable="a joint has play")
    diagnosis = replace(diagnosis, nearest=nearest, candidates=(nearest, *diagnosis.candidates[1:]))
    comparison = page_content(diagnosis)["comparison"]
    assert bool(comparison["nearest"]) is has_card
    shown = [card["id"] for card in comparison["nearest"]] + [effect for _, effect, _ in comparison["unnoticed"]]
    assert sorted(shown) == sorted(candidate.effects[0] for candidate in diagnosis.candidates)


def test_the_smallest_detectable_size_is_a_clause_in_units_that_a_reader_knows():
    assert clause_of_size(EFFECTS["cavitation"], 2e-3) == "cavitation limits the force in compression to 500 N"
    assert clause_of_size(EFFECTS["flow_asymmetry"], 0.0096).startswith("the force differs by 0.96 % in extension")
    assert clause_of_size(EFFECTS["end_stop"], 2e4).endswith("where it is compressed, with a stiffness of 20 kN/m²")


def test_the_size_of_an_alternative_is_reported(tmp_path):
    diagnosis = diagnosed("ambiguous")
    (alternative,) = to_json(diagnosis)["alternatives"]
    assert alternative["parameters"]["lag"]["value"] == 0.009
    page = markup_of(write_gap_report(diagnosis, tmp_path))
    assert "The damper&#39;s force lags its current by 9.0 ± 0.5 ms</td>" in page


def test_a_parameter_that_any_value_fits_has_a_remark():
    diagnosis = diagnosed("explained")
    time = ParameterEstimate(Interval(700.0, 30.0, 3000.0), "s", "not determined by these runs")
    fade = ParameterEstimate(about(6e-5), "1/J")
    cause = replace(diagnosis.causes[0], effect="thermal_fade", parameters={"fade": fade, "cooling_time": time})
    (card,) = page_content(replace(diagnosis, causes=(cause,)))["comparison"]["causes"]
    fade_row, time_row = card["parameters"]
    assert fade_row[1] == "60 ± 3 per MJ"
    assert not fade_row[3]
    assert time_row[1] == "700 s"
    assert time_row[3] == (
        "not determined by these runs: any plausible value (30 s to 3000 s) fits about as well; the default is 400 s"
    )


def test_parameters_stand_side_by_side(tmp_path):
    diagnosis = diagnosed("explained")
    names = diagnosis.model.names
    sets = [dict.fromkeys(names, value) for value in (0.0625, 0.125, 0.25)]
    corrected = replace(diagnosis.corrected, as_given=sets[0], without_effects=sets[1], parameters=sets[2])
    markup = markup_of(write_gap_report(replace(diagnosis, corrected=corrected), tmp_path))
    assert re.search(r"as given</th><th[^>]*>refitted</th><th[^>]*>with the cause</th>", markup)
    first = format_quantity(0.0625, diagnosis.model.parameters[0].unit)
    assert re.search(rf"<code>{names[0]}</code></td><td[^>]*>{first}</td>", markup)
    only = markup_of(write_gap_report(replace(diagnosis, corrected=replace(corrected, as_given={})), tmp_path))
    assert "as given</th>" not in only
    assert "refitted</th>" in only


def test_what_removes_nothing_needs_no_table(capsys, tmp_path):
    diagnosis = diagnosed("unknown_effect")
    candidates = tuple(replace(candidate, closed_fraction=about(0.001)) for candidate in diagnosis.candidates)
    diagnosis = replace(diagnosis, candidates=candidates, nearest=None)
    print_summary(diagnosis, write_gap_report(diagnosis, tmp_path))
    assert "15 effects were tried; none removes more than 0.5 % of the gap." in capsys.readouterr().out
    assert not page_content(diagnosis)["comparison"]["candidates"]


def test_without_a_gap_no_table_says_how_much_of_it_effects_remove(capsys, tmp_path):
    diagnosis = diagnosed("no_gap")
    print_summary(diagnosis, write_gap_report(diagnosis, tmp_path))
    output = capsys.readouterr().out
    assert f"{len(diagnosis.candidates)} effects were tried. None is needed to explain the error." in output
    assert "gap removed" not in output


def test_an_effect_that_imitates_the_cause_is_called_so():
    diagnosis = diagnosed("explained")
    texts = {candidate.effects[0]: describe_candidate(diagnosis, candidate) for candidate in ordered_candidates(diagnosis)}
    assert texts["lvdt_nonlinearity"].remark == "imitates the cause, which removes more"
    assert not describe_candidate(diagnosed("unknown_effect"), diagnosis.candidates[3]).remark


def test_what_a_wrong_form_may_imitate_is_called_unproven(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("COLUMNS", "200")
    diagnosis = diagnosed("partly_explained")
    texts = {candidate.effects[0]: describe_candidate(diagnosis, candidate) for candidate in ordered_candidates(diagnosis)}
    assert texts["channel_delay"].remark == "named as a cause"
    assert texts["lvdt_nonlinearity"].remark == "not proven around other damper models"
    print_summary(diagnosis, tmp_path / "gap_report.html")
    output = capsys.readouterr().out
    assert output.startswith(f"{diagnosis.sentence}\nnext step: Add the cause to your simulator")
    assert "probability" not in output.partition("next command")[2]
    assert "named as a cause" in output


def test_the_form_is_not_spoken_of_where_nobody_asked_for_it(tmp_path):
    """The report of a change said that a freer form removes almost nothing, although none had been fitted."""
    diagnosis = diagnosed("partly_explained")
    gap = replace(diagnosis.gap, form_fraction=float("nan"))
    page = write_gap_report(replace(diagnosis, gap=gap, reference=diagnosis.runs[:1]), tmp_path).read_text()
    for text in ("would remove almost nothing", "of the gap lies in the form", "neither a cause nor the form"):
        assert text not in page
    assert "error of the model and a function common to the runs before and after" in page


def test_candidates_are_shown_in_the_order_of_the_columns():
    diagnosis = diagnosed("explained")
    shown = ordered_candidates(replace(diagnosis, candidates=diagnosis.candidates[::-1]))
    assert [candidate.probability for candidate in shown[:3]] == [0.9, 0.06, 0.03]
    removed = [candidate.closed_fraction.value for candidate in shown[3:]]
    assert removed == sorted(removed, reverse=True)


def test_that_nothing_was_extrapolated_is_said_only_where_no_run_goes_beyond_the_others():
    diagnosis = diagnosed("explained")
    diagnosis = replace(diagnosis, gap=replace(diagnosis.gap, extrapolated=None))
    within = tuple(replace(residual, extrapolates="") for residual in diagnosis.residuals)
    for residuals, is_said in ((within, True), (diagnosis.residuals, False), (within[:1], False)):
        notes = page_content(replace(diagnosis, residuals=residuals))["comparison"]["error_notes"]
        assert any(note.startswith("No run exceeds the others") for note in notes) is is_said


def test_a_check_that_finds_nothing_is_a_lower_bound():
    diagnosis = diagnosed("unknown_effect")
    diagnosis = replace(diagnosis, gap=replace(diagnosis.gap, explainable_fraction=0.0))
    assert any(note.endswith("it is a lower bound.") for note in page_content(diagnosis)["comparison"]["error_notes"])


@pytest.mark.parametrize(("offset", "text"), [(0.0012, "+1.2 mN"), (-3.25, "\u22123.25 N"), (0.0, "0 N")])
def test_small_offsets_keep_their_figures(offset, text):
    diagnosis = diagnosed("explained")
    residuals = (replace(diagnosis.residuals[0], offset=offset),)
    assert page_content(replace(diagnosis, residuals=residuals))["comparison"]["runs"][0]["offset"] == text


def test_runs_are_called_held_out_as_they_were():
    diagnosis = diagnosed("explained")
    first, second, third = diagnosis.residuals
    residuals = (second, replace(third, by_folds=True), replace(first, held_out=True))
    comparison = page_content(replace(diagnosis, held_out_by="runs", residuals=residuals))["comparison"]
    assert [run["held_out"] for run in comparison["runs"]] == ["whole run", "by segments", "from the start"]


def test_the_advised_experiment_lies_beside_the_report(tmp_path):
    diagnosis, experiment = diagnosed("ambiguous"), tmp_path / "next_experiment.yaml"
    assert diagnosis.next_experiment.text in markup_of(write_gap_report(diagnosis, tmp_path))
    assert experiment.read_text() == EXPERIMENT
    advice = Advice("No run would tell them apart.", between=("channel_delay", ""))
    without = replace(diagnosis, next_experiment=advice)
    assert "The experiment is in <code>" not in markup_of(write_gap_report(without, tmp_path))
    assert not experiment.exists()


def test_the_page_says_how_sure_and_how_much_before_the_rest(tmp_path):
    markup = markup_of(write_gap_report(diagnosed("explained"), tmp_path))
    order = ['class="badge explained"', "The force channel is late", "probability of the cause", "Next command:", "<h2>"]
    places = [markup.index(text) for text in order]
    assert places == sorted(places)
    assert f"apply {tmp_path}/gap_report.json" in markup


def test_faults_come_first_and_nothing_is_compared(tmp_path):
    diagnosis = diagnosed("data_fault")
    markup = markup_of(write_gap_report(diagnosis, tmp_path))
    assert markup.index("42 samples") < markup.index("Recordings</h2>")
    assert "Effects that were tried" not in markup
    assert "Where the gap" not in markup
    content = read_gap_report(tmp_path / "gap_report.json")
    assert content["gap"] is None
    assert content["corrected"] is None
    assert [run["name"] for run in content["runs"]["fit"]] == [run.name for run in diagnosis.runs]


WHERE = r"[\w %]+ of {} lies? .*, which is (\d+|less than 1) % of the samples\."


def test_sentences():
    assert re.fullmatch(
        r"The force channel is late by 12\.0 ± 0\.6 ms \(probability 90 % among the 15 effects that were tried\)\. "
        r"Adding this effect removes 100 % of the gap\. "
        r"On the runs that go beyond the others in stroke, speed or current, this removes only 90 %\. "
        rf"{WHERE.format('the error')} .*delay of the force channel must show\.",
        diagnosed("explained").sentence,
    )
    gap = diagnosed("no_gap").gap
    assert diagnosed("no_gap").sentence.startswith(
        "The parameters caused the gap. With refitted parameters, the error falls"
    )
    no_gap = with_sentence(diagnosed("no_gap"), gap=replace(gap, as_given=None))
    assert no_gap.sentence.startswith("No gap beyond the noise. The model's error is 0.9")
    assert no_gap.sentence.endswith("%.")
    # One run is needed for parameters that the others do not show: held out, it errs by far more than the noise.
    needed = with_sentence(diagnosed("no_gap"), gap=replace(gap, as_given=None, before=Interval(5 * gap.noise_floor.value)))
    assert needed.sentence.endswith("where a whole run is held out, because the others do not determine all parameters.")
    blocks = with_sentence(needed, held_out_by="blocks", gap=replace(needed.gap, as_given=9.0))
    assert "noise explains" not in blocks.sentence
    assert blocks.sentence.startswith("The parameters caused the gap.")
    assert blocks.sentence.endswith("where a segment is held out, because the others do not determine all parameters.")
    assert diagnosed("data_fault").sentence == (
        "Data problem (run multisine_1, force): 42 samples stay at 981 N; widen the range. (1 more problem below.)"
    )
    assert re.fullmatch(
        r"None of the effects that these runs can test \(15\) explains the gap; 2 more cannot be tested with them\. "
        rf"{WHERE.format('the error')} "
        r"Lag of the force sensor comes nearest: this would remove \d+ % of the gap\. "
        r"A freer form of the damper model would remove 31 % of the gap: the force depends on speed, recent travel and "
        r"current in another way than the model says\.",
        diagnosed("unknown_effect").sentence,
    )


def test_the_sentence_on_a_part_of_the_gap():
    diagnosis = diagnosed("partly_explained")
    assert re.fullmatch(
        r"The force channel is late by 11\.9 ± 0\.6 ms \(probability 90 % among the 15 effects that were tried\)\. "
        r"Adding this effect removes 26 % of the gap\. "
        r"In place of delay of the force channel, the cause may be lag behind the coil current \(7 %\)\. "
        r"Another 8 % lies in the form of the damper model: in how its force depends on speed, recent travel and current\. "
        rf"{WHERE.format('the remaining error')}",
        diagnosis.sentence,
    )
    # Causes and form are judged on different folds; together they are never more than the gap.
    more = with_sentence(diagnosis, gap=replace(diagnosis.gap, form_fraction=0.9))
    assert more.sentence.startswith("Most of the gap (74 %) lies in the form")
    little = with_sentence(diagnosis, gap=replace(diagnosis.gap, form_fraction=0.03), where=(), alternatives=())
    assert little.sentence.endswith("of the gap.")


def test_an_alternative_that_was_not_refitted_has_no_size():
    comparison = SimpleNamespace(effects=("channel_delay",), alternatives={"channel_delay": {"channel_delay": None}})
    probabilities = {"channel_delay": {"channel_delay": 0.8, "coil_lag": 0.15, "seal_friction": 0.04}}
    (alternative,) = list_alternatives(comparison, probabilities)
    assert (alternative.effect, alternative.instead_of, alternative.probability) == ("coil_lag", "channel_delay", 0.15)
    assert not alternative.parameters


def test_what_is_a_cause_beside_another_one_is_no_alternative_to_it():
    """A play in a joint was named, and listed in place of the side-load friction that was named beside it."""
    comparison = SimpleNamespace(effects=("joint_play", "side_load_friction"), alternatives={"side_load_friction": {}})
    probabilities = {"side_load_friction": {"side_load_friction": 0.48, "joint_play": 0.11, "backlash": 0.12}}
    assert [alternative.effect for alternative in list_alternatives(comparison, probabilities)] == ["backlash"]


def test_a_form_that_is_not_wrong_is_a_clue():
    diagnosis = diagnosed("unknown_effect")
    text = with_sentence(diagnosis, gap=replace(diagnosis.gap, form_fraction=0.02)).sentence
    assert text.endswith(
        "A freer form of the damper model would remove almost nothing: what is missing depends on more than speed, recent "
        "travel and current."
    )


def test_the_page_says_what_remains_beside_the_causes(tmp_path):
    diagnosis = diagnosed("partly_explained")
    comparison = page_content(diagnosis)["comparison"]
    opened, where, form, neither, model, flexible = comparison["remains"]
    assert opened == "With the cause, 74 % of the gap stays open."
    assert re.fullmatch(WHERE.format("it"), where)
    assert form.startswith("8 % of the gap lies in the form of the damper model: a freer function of speed, recent travel")
    assert neither == "For 66 % of the gap, neither a cause nor the form accounts."
    assert model.startswith("Of the other damper models, modified_dahl comes nearest to the recordings: without an effect,")
    assert re.search(r"was fitted to the remaining error alone.* 64 %", flexible)
    (card,) = comparison["causes"]
    assert card["facts"].startswith("probability 90 % · removes 26 % (")
    assert not comparison["nearest"]
    assert comparison["alternatives"][0][:2] == ("Lag behind the coil current", "coil_lag")
    markup = markup_of(write_gap_report(diagnosis, tmp_path))
    order = [
        "Partly explained</span>",
        "Cause</h2>",
        "What remains</h2>",
        "Other damper models</h2>",
        "Where the remaining error lies</h2>",
    ]
    places = [markup.index(text) for text in order]
    assert places == sorted(places)
    worse = replace(diagnosis, alternative_models=(AlternativeModel("sigmoid", 0.4, about(-0.2), "sigmoid"),))
    assert any(line.startswith("None of the other") for line in page_content(worse)["comparison"]["remains"])


def test_the_chart_of_errors_shows_what_remains_beside_the_causes():
    diagnosis = diagnosed("partly_explained")
    gap = diagnosis.gap
    bars = figures.error_chart(diagnosis, gap).data[0]
    error = {name.replace("<br>", " "): value for name, value in zip(bars.y, bars.x, strict=True)}
    floor, before, after = (value.value**2 for value in (gap.noise_floor, gap.before, gap.after))
    freer = after - 0.08 * (before - floor)
    assert error["with the cause, and a freer form"] == pytest.approx(np.sqrt(freer), abs=1e-5)
    flexible = floor + (1 - 0.64) * (after - floor)
    assert error["with the cause, and a free correction"] == pytest.approx(np.sqrt(flexible), abs=1e-5)
    unknown = diagnosed("unknown_effect")
    assert "with a freer form" in figures.error_chart(unknown, unknown.gap).data[0].y
    explained = diagnosed("explained")
    assert not any("form" in name for name in figures.error_chart(explained, explained.gap).data[0].y)


def test_the_sentence_on_ambiguous_causes():
    diagnosis = diagnosed("ambiguous")
    assert re.fullmatch(
        r"These runs do not show whether the force channel is late by 12\.0 ± 0\.6 ms or the damper's force lags its "
        r"current by 9\.0 ± 0\.5 ms \(probabilities 90 % and 38 %\)\. "
        rf"The most likely explanation removes \d+ % of the gap\. {WHERE.format('the error')} .*",
        diagnosis.sentence,
    )
    assert re.fullmatch(
        r"Probably the force channel is late by 12\.0 ± 0\.6 ms \(probability 90 % among the 15 effects that were tried\)\. "
        rf"Adding this effect removes \d+ % of the gap\. {WHERE.format('the error')} .*must show\.",
        with_sentence(diagnosis, alternatives=()).sentence,
    )
    model = replace(diagnosis.alternatives[0], effect="sigmoid", parameters={})
    text = with_sentence(diagnosis, alternatives=(model,)).sentence
    assert "or another damper model is right (sigmoid) (probabilities" in text
    certain = Cause("joint_play", 0.97, 0.005, about(0.5), {"joint_play.play": ParameterEstimate(about(3e-4), "m")})
    text = with_sentence(diagnosis, causes=(certain, *diagnosis.causes)).sentence
    assert text.startswith(
        "A joint has 0.300 ± 0.015 mm of play. Beyond that, these runs do not show whether the force channel is late"
    )


def test_the_sentence_on_several_causes_and_on_sure_ones():
    diagnosis = diagnosed("explained")
    certain = Cause("joint_play", 0.97, 0.005, about(0.5), {"joint_play.play": ParameterEstimate(about(3e-4), "m")})
    both = with_sentence(diagnosis, causes=(certain, *diagnosis.causes)).sentence
    assert "of play and the force channel is late by 12.0 ± 0.6 ms (probability at least 90 % among the 15 effects" in both
    assert "Adding both effects removes" in both
    alone = with_sentence(diagnosis, candidates=diagnosis.candidates[:1]).sentence
    assert "(probability 90 %, no other effect was tried)" in alone
    sure = with_sentence(diagnosis, causes=(replace(certain, probability=0.99999),)).sentence
    assert "(probability above 99 % among the 15 effects that were tried)" in sure


def test_the_sentence_on_an_unknown_effect_points_only_at_significant_regions():
    diagnosis = diagnosed("unknown_effect")
    where = tuple(replace(region, q_value=0.3) for region in diagnosis.where)
    text = with_sentence(diagnosis, where=where, untestable=()).sentence
    assert text.startswith(
        "None of the effects that these runs can test (15) explains the gap. Lag of the force sensor comes nearest"
    )
    text = with_sentence(diagnosis, where=where).sentence
    assert "None of the effects that these runs can test (15) explains the gap; 2 more cannot be tested" in text
    model = AlternativeModel("modified_dahl", 0.01, Interval(1.0), "modified_dahl")
    text = with_sentence(diagnosis, where=(), alternative_models=(model,)).sentence
    assert text.startswith("Most of the gap (100 %) lies in the form of the damper model")
    assert text.endswith("The model modified_dahl removes 100 %: try it next.")
    less = replace(model, closed_fraction=Interval(0.4))
    nearest = replace(diagnosis.nearest, closed_fraction=Interval(0.1))
    text = with_sentence(diagnosis, where=(), nearest=nearest, alternative_models=(less,)).sentence
    assert text.endswith("The model modified_dahl removes 40 %: try it next.")


def test_an_oscillation_is_named_in_place_of_bands_of_frequencies():
    diagnosis = diagnosed("unknown_effect")
    line = Region("frequency", 29.0, 34.5, "Hz", Interval(0.89), float("nan"), float("nan"), "an oscillation near 31 Hz")
    level = replace(line, axis="current", label="at 0.3 A", share=about(0.79), lift=2.4, q_value=0.001)
    band = replace(level, axis="frequency", label="frequencies of 10 to 30 Hz", share=about(0.46))
    diagnosis = with_sentence(diagnosis, where=(band, level), oscillation=line)
    assert (
        "Nearly all of the error (89 %) is an oscillation near 31 Hz, "
        "and 79 % of the error lies at 0.3 A, which is 33 % of the samples." in diagnosis.sentence
    )
    assert significant_regions(diagnosis) == [line, level]
    assert to_json(diagnosis)["oscillation"]["label"] == line.label
    assert figures.region_chart([band, level]).data[1].x == (pytest.approx(0.79 / 2.4, abs=1e-4), None)


def test_the_next_command_follows_from_the_verdict():
    assert next_command(diagnosed("explained"), "my runs") == (
        "ros2 run mrd_diagnosis apply 'my runs'/gap_report.json --plant PLANT.yaml --output CORRECTED.yaml"
    )
    partly = diagnosed("partly_explained")
    assert next_command(partly) == next_command(diagnosed("explained"))
    other = replace(partly, alternative_models=(AlternativeModel("modified_dahl", 0.01, about(0.9), "modified_dahl"),))
    assert next_command(other).splitlines() == [
        "ros2 run mrd_diagnosis diagnose RUN... --model modified_dahl --output DIR",
        next_command(partly),
    ]
    assert next_step(other).startswith(
        "Diagnose the runs with the model modified_dahl first, by the first command: it removes 90 %"
    )
    record, diagnose_again = next_command(diagnosed("ambiguous")).splitlines()
    assert record == "ros2 run mrd_bench_driver bench DIR/next_experiment.yaml"
    assert diagnose_again.startswith("ros2 run mrd_diagnosis diagnose RUN... NEW_RUN --model ")
    # Without an experiment, the most likely cause can still be applied.
    command = next_command(replace(diagnosed("ambiguous"), next_experiment=Advice("Add a sensor.")))
    assert command == f"{next_command(diagnosed('explained'))} --anyway"
    # What a cause does to the ride of a hybrid test is told by another tool.
    hybrid = replace(partly.runs[0], info={"source": "runs/my bag", "experiment": "name: a\nlaw: skyhook\n"})
    closed = replace(diagnosed("explained"), runs=(hybrid, *partly.runs[1:]))
    assert next_command(closed).splitlines()[1:] == [
        "ros2 run mrd_control review 'runs/my bag' --diagnosis DIR/gap_report.json --output DIR"
    ]
    assert closed_loop_notes(closed.runs)[0].startswith(f"{hybrid.name}: a closed loop (hybrid test).")
    assert closed_loop_notes(partly.runs) == []
    unknown = diagnosed("unknown_effect")
    # The nearest effect removes more than the other model.
    assert next_command(unknown) == ""
    unknown = replace(unknown, nearest=None)
    assert next_command(unknown) == "ros2 run mrd_diagnosis diagnose RUN... --model modified_dahl --output DIR"
    for name, change, command in (
        (
            "bouc_wen with quadratic current laws",
            {"law": "quadratic"},
            "ros2 run mrd_diagnosis diagnose RUN... --model bouc_wen --law quadratic --output DIR",
        ),
        (
            "bouc_wen with exponent fitted too",
            {"freed": ("exponent",)},
            "ros2 run mrd_identification identify RUN... --model bouc_wen --free exponent --output DIR",
        ),
    ):
        model = AlternativeModel(name, 0.01, about(0.9), "bouc_wen", **change)
        assert next_command(replace(unknown, alternative_models=(model,))) == command
    assert next_command(diagnosed("no_gap")) == next_command(diagnosed("data_fault")) == ""


def test_the_next_command_names_the_laws_and_the_folders_of_the_user(user_effects):
    ambiguous = diagnosed("ambiguous")
    ambiguous = replace(ambiguous, model=ambiguous.model.with_laws({"viscous": "tanh"}))
    load_effects(user_effects)
    folder = f" --effects-folder {user_effects}"
    assert next_command(diagnosed("explained")).endswith(f" --output CORRECTED.yaml{folder}")
    again = next_command(ambiguous).splitlines()[1]
    assert " --model bouc_wen --law " in again
    assert "viscous=tanh" in again
    assert again.endswith(f"{folder} --output DIR")


def test_a_bench_is_advised_only_where_one_can_be(monkeypatch):
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    (command,) = next_command(diagnosed("ambiguous")).splitlines()
    assert command.startswith("mrd diagnose RUN... NEW_RUN --model ")


def test_the_next_command_names_the_files_of_the_runs():
    unknown = replace(diagnosed("unknown_effect"), nearest=None)
    *runs, last = (replace(run, info={"source": f"my runs/{run.name}.csv"}) for run in unknown.runs)
    unknown = replace(unknown, runs=tuple(runs), held_out=(last,))
    assert next_command(unknown) == (
        "ros2 run mrd_diagnosis diagnose 'my runs/multisine_1.csv' 'my runs/multisine_2.csv' "
        "--held-out 'my runs/multisine_3.csv' --model modified_dahl --output DIR"
    )
    content = page_content(unknown)
    assert content["title"] == "Bouc-Wen model against 3 runs of my runs"
    assert content["placeholders"] == ["DIR: a folder for the reports"]


def test_the_next_step_follows_from_the_findings():
    unknown = diagnosed("unknown_effect")
    coverage = Finding(
        "coverage", "limitation", "all strokes peak at one speed: nothing else is known. Record other speeds."
    )
    models = "Other damper models were tried and do not explain the gap either: the best one removes 30 % of it."
    unknown = replace(unknown, oscillation=None)
    assert next_step(replace(unknown, findings=(coverage,))) == (
        f"{models} Record other speeds. Then diagnose all runs again."
    )
    assert next_step(replace(unknown, findings=())).startswith(f"{models} See where the error lies")
    assert next_step(replace(unknown, nearest=None)) == "Try the model modified_dahl."
    ambiguous = diagnosed("ambiguous")
    assert next_step(ambiguous) == f"{ambiguous.next_experiment.text} Diagnose all runs again, together with the new one."
    sensor = replace(ambiguous, next_experiment=Advice("Add a sensor."))
    others = ", ".join(alternative.effect for alternative in ambiguous.alternatives)
    assert next_step(sensor) == (
        f"Add a sensor. If that shows another one, diagnose the runs again with --effects {others} and apply that. "
        "Until then, the next command applies the most likely explanation, which is not proven."
    )
    line = replace(unknown.where[0], label="an oscillation near 31 Hz")
    assert "Look for the source of an oscillation near 31 Hz" in next_step(replace(unknown, oscillation=line))
    assert next_step(diagnosed("no_gap")) == next_step(diagnosed("data_fault")) == ""


def test_the_terminal_shows_all_of_its_summary(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    diagnosis = diagnosed("ambiguous")
    effects = ("rate_dependent_hysteresis", "pre_yield_hysteresis", "channel_delay")
    together = replace(diagnosis.candidates[0], effects=effects)
    print_summary(replace(diagnosis, candidates=(together, *diagnosis.candidates)), tmp_path / "gap_report.html")
    output = capsys.readouterr().out
    step, command = next_step(diagnosis), next_command(diagnosis, str(tmp_path))
    assert output.startswith(f"{diagnosis.sentence}\nnext step: {step}\nnext command: {command}\n")
    lines = output.splitlines()
    assert all(any(effect in line for line in lines) for effect in effects)
    assert not any("…" in line for line in lines)
    assert max(len(line) for line in lines if line.startswith(" ")) <= 80
    assert "The table shows the best 8 of 16 candidates; the report lists all." in lines
    paths = [str(tmp_path / name) for name in ("gap_report.html", "gap_report.json", "next_experiment.yaml")]
    assert lines[-4:] == [f"note: {diagnosis.notes[0]}", *paths]


def test_the_corrected_model_has_a_name_where_it_contains_effects():
    assert corrected_label(diagnosed("explained")) == corrected_label(diagnosed("partly_explained")) == "with the cause"
    assert corrected_label(diagnosed("ambiguous")) == "with the most likely cause"
    assert corrected_label(diagnosed("unknown_effect")) == "with the nearest effect"
    assert corrected_label(diagnosed("no_gap")) == corrected_label(diagnosed("data_fault")) == ""


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_has_a_phrase(effect):
    parameters = EFFECTS[effect].parameters
    clause = effect_clause(effect, {f"{effect}.{p.name}": ParameterEstimate(about(p.upper), p.unit) for p in parameters})
    assert EFFECTS[effect].phrase
    assert not set("{}") & set(clause)
    assert clause == effect_clause(effect, {p.name: ParameterEstimate(about(p.upper), p.unit) for p in parameters})
    assert "±" in clause


def test_a_size_that_may_be_any_is_called_undetermined():
    viscous, exponent, *_ = EFFECTS["shear_thinning"].parameters
    sizes = {
        "viscous": ParameterEstimate(Interval(viscous.upper, viscous.lower, viscous.upper), viscous.unit, UNDETERMINED),
        "exponent": ParameterEstimate(Interval(0.9, exponent.lower, 0.95), exponent.unit),
    }
    clause = effect_clause("shear_thinning", sizes)
    assert "10 kN·s/m (not determined) of its viscosity" in clause
    assert "the exponent 0.9 (0.3 to " in clause


def test_an_effect_without_phrase_is_called_by_its_title(monkeypatch):
    monkeypatch.setitem(EFFECTS, "joint_play", replace(EFFECTS["joint_play"], phrase=""))
    parameters = {"joint_play.play": ParameterEstimate(Interval(3e-4), "m")}
    assert effect_clause("joint_play", parameters) == "play in a joint (play 0.3 mm)"
    assert effect_clause("long_gone", {}) == "another damper model is right (long_gone)"


@pytest.mark.parametrize(
    ("value", "unit", "style", "text"),
    [
        (0.031, "s", "", "31 ms"),
        (4e-7, "m/N", "", "0.4 µm/N"),
        (2e-4, "m", "", "0.2 mm"),
        (Interval(0.031, 0.029, 0.033), "s", "", "31 ± 2 ms"),
        (Interval(0.031, 0.030, 0.036), "s", "", "31 ms (30 to 36)"),
        (Interval(0.031), "s", "", "31 ms"),
        (2.5e4, "N s/m", "", "25 kN·s/m"),
        (5e6, "N/m²", "", "5 MN/m²"),
        (2000.0, "N/m", "", "2000 N/m"),
        (1.5e-3, "1/N", "inverse", "667 N"),
        (Interval(0.5, 0.4, 0.9), "1/A", "inverse", "2.0 A (1.1 to 2.5)"),
        (6e-5, "1/J", "%", "6 % per kJ"),
        (12.0, "1/m", "", "12 per m"),
        (0.05, "", "%", "5 %"),
        (0.7, "", "", "0.7"),
        (Interval(-1.5e-5, -1.8e-5, -1.2e-5), "m", "size", "15 ± 3 µm"),
        (-0.02, "N/s", "", "−20 mN/s"),
        (np.pi / 2, "rad", "", "90°"),
        (0.05, "kg", "", "50 g"),
        (0.0, "N", "", "0 N"),
        (Interval(0.0, -20.0, 20.0), "N", "", "0 ± 20 N"),
        (float("nan"), "s", "", "–"),
    ],
)
def test_quantities_are_written_as_a_person_writes_them(value, unit, style, text):
    assert format_quantity(value, unit, style) == text


@given(st.floats(1e-9, 1e9), st.sampled_from(["s", "m", "m/N", "N/m", "N s/m", "A", "1/A", "kg", "rad", ""]), st.booleans())
def test_quantities_keep_their_size_whatever_their_unit(value, unit, negative):
    text = format_quantity(-value if negative else value, unit)
    number, _, written = text.partition(" ") if unit != "rad" else (text[:-1], "", "°")
    prefix = {"µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6, "G": 1e9, "g": 1e-3}
    base = unit.partition(" ")[0].partition("/")[0]
    head = written.partition("/")[0].partition("·")[0].removeprefix("per ")
    factor = np.pi / 180 if unit == "rad" else prefix[head[0]] if head not in (base, "") and head[0] in prefix else 1.0
    if written.startswith("per "):
        factor = 1 / prefix[head[0]] if head[0] in prefix and len(head) > 1 else 1.0
    assert float(number.replace("\u2212", "-")) * factor == pytest.approx(-value if negative else value, rel=5e-3)


def test_shares():
    assert format_share(0.931) == "93 %"
    assert format_share(Interval(0.931, 0.88, 0.96)) == "93 % (88 to 96)"
    assert format_share(Interval(-1.0, -1.0, -1.0)) == "≤ \u2212100 %"
    assert format_share(float("nan")) == "–"


def test_the_least_p_value_that_can_be_resolved_is_a_bound():
    problem = SimpleNamespace(noise_cost=1.0)
    assert format_p_value(NullGains(np.zeros(REALISATIONS), 1.0).p_value(10.0, problem)) == "≤ 0.001"
    gains = np.append(np.zeros(REALISATIONS - 1), 11.0)
    assert format_p_value(NullGains(gains, 1.0).p_value(10.0, problem)) == "0.002"


def test_errors_keep_three_figures():
    assert (format_error(0.01134), format_error(0.00979)) == ("1.13 %", "0.979 %")


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "< 1 %"), (0.38, "38 %"), (0.9999, "> 99 %"), (1.0, "> 99 %"), (float("nan"), "–")]
)
def test_probabilities_are_never_certain(value, text):
    assert format_probability(value) == text


def test_an_unreadable_report_is_refused_in_one_line(tmp_path):
    file = tmp_path / "gap_report.json"
    with pytest.raises(InputError, match=r"gap_report\.json: cannot be read"):
        read_gap_report(file)
    for text, message in (
        ("{", "is not JSON"),
        ("[1]", "its schema is None, expected a gap_report.json of mrd-gap/5"),
        ('{"schema": "mrd-fit/3"}', "its schema is mrd-fit/3, expected"),
        ('{"schema": "mrd-gap/5"}', "'sentence' is a required property; expected a gap_report.json"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message) as refused:
            read_gap_report(file)
        assert "\n" not in str(refused.value)
    content = to_json(diagnosed("explained"))
    content["causes"][0]["probability"] = 1.5
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"causes/0/probability: 1\.5 is greater than the maximum of 1; expected"):
        read_gap_report(file)


def test_the_schema_describes_every_field():
    schema = read_schema("mrd_diagnosis", "gap_report")
    for name, part in schema["properties"].items():
        assert part, name
    content = {name: value for name, value in to_json(diagnosed("no_gap")).items() if name != "verdict"}
    with pytest.raises(jsonschema.ValidationError, match="verdict"):
        jsonschema.validate(content, schema)


def test_the_most_informative_segment_of_the_most_informative_run_is_shown():
    diagnosis = diagnosed("explained")
    shown = figures.most_informative_run(diagnosis.residuals)
    removed = [np.sum(residual.before**2 - residual.after**2) for residual in diagnosis.residuals]
    assert shown is diagnosis.residuals[int(np.argmax(removed))]
    sudden = np.zeros(len(shown.before))
    sudden[700:720] = 50.0
    segment = figures.most_informative_segment(replace(shown, before=sudden, after=0 * sudden), 0.5)
    first, last = segment[0] - shown.recording.counted.start, segment[-1] - shown.recording.counted.start
    assert first <= 700
    assert last >= 719
    loops = figures.hysteresis_loops(shown, "with the cause")
    measured, refitted, after = (line.y for line in loops[0].data)
    assert np.sqrt(np.mean((measured - after) ** 2)) == pytest.approx(NOISE, rel=0.2)
    assert np.sqrt(np.mean((measured - refitted) ** 2)) > 3 * NOISE


def test_the_chart_of_candidates_says_what_its_numbers_are():
    chart = figures.candidate_chart(diagnosed("ambiguous"))
    texts = [annotation.text for annotation in chart.layout.annotations]
    assert "probability" in texts
    assert "<b>90 %</b>" in texts
    assert "<b>< 1 %</b>" in texts
    # The alternative has the probability that the table of alternatives states.
    assert "<b>38 %</b>" in texts
    assert chart.layout.xaxis.title.text == "share of the gap removed"
    # They stand beside the bars, also on a telephone.
    assert all(annotation.x > 1.0 for annotation in chart.layout.annotations)
    # Where none of the candidates is the cause, a probability would mislead.
    for verdict in ("no_gap", "partly_explained", "unknown_effect"):
        assert not figures.candidate_chart(diagnosed(verdict)).layout.annotations


@given(low=st.floats(1e-5, 1e3), ratio=st.floats(4.0, 1e5))
def test_the_colour_bar_of_a_spectrum_tells_its_scale(low, ratio):
    axis = figures._colour_axis("N/√Hz", low, low * ratio)
    ticks = np.array(axis["colorbar"]["tickvals"])
    assert figures.LEAST_TICKS <= len(ticks) <= 9
    assert np.all((ticks >= axis["cmin"] - 1e-9) & (ticks <= axis["cmax"] + 1e-9))


def test_sentences_of_tables_are_marked_for_telephones(tmp_path):
    """They stand beneath the numbers of their row there; a column of them was cut off."""
    page = write_gap_report(diagnosed("explained"), tmp_path).read_text(encoding="utf-8")
    for heading in ("meaning", "could be present up to this size", "finding"):
        assert f"<th>{heading}</th>" not in page
    assert '<th class="prose">meaning</th>' in page
    assert page.count('<td class="prose">') > 10


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to open the page with")
@pytest.mark.parametrize("verdict", [pytest.param(v, marks=[pytest.mark.slow] * (v != "explained")) for v in VERDICTS])
def test_the_page_draws_in_a_browser_without_errors(verdict, tmp_path):
    page = write_gap_report(diagnosed(verdict), tmp_path)
    options = (
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={tmp_path / 'profile'}",
        "--window-size=1100,2500",
        "--enable-logging=stderr",
        "--virtual-time-budget=9000",
        "--dump-dom",
    )
    done = subprocess.run([CHROMIUM, *options, page.as_uri()], capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in done.stderr
    assert done.stdout.count('<figure class="plot"') == {"data_fault": 0, "no_gap": 8}.get(verdict, 9)


def test_what_was_seen_and_not_named_stands_in_one_sentence():
    diagnosis = diagnosed("partly_explained")
    seen = [
        Rejected(effect, rule, why, True, 0.6, 1e-3, about(0.1), {})
        for effect, rule, why in (
            ("shear_thinning", "undetermined", "these runs do not determine its size"),
            ("gas_spring", "little", "it closes next to nothing of the gap"),
        )
    ]
    sentence = verdict_sentence(replace(diagnosis, rejected=tuple(seen)))
    assert (
        "Seen as well, but not named as a cause: shear thinning (these runs do not determine its size) and gas spring "
        "(it closes next to nothing of the gap)."
    ) in sentence


def test_of_a_class_it_is_said_which_member_was_added():
    diagnosis = diagnosed("explained")
    (cause,) = diagnosis.causes
    members = (Member(cause.effect, 0.5, 1.0, cause.parameters), Member("force_sensor_lag", 0.4, 0.9, {}))
    of_class = replace(cause, level="class", members=members)
    diagnosis = with_sentence(diagnosis, causes=(of_class,))
    assert "Adding delay of the force channel removes " in diagnosis.sentence
    # At the top of the page, the class has the probability that the sentence states.
    assert "(probability 90 % among" in diagnosis.sentence
    assert page_content(diagnosis)["comparison"]["headline"][0][0] == "90 %"


def test_only_a_cause_in_whose_place_another_may_stand_is_called_unsure():
    diagnosis = diagnosed("ambiguous")
    (cause,) = diagnosis.causes
    sure = replace(cause, effect="flow_asymmetry", parameters={}, members=())
    cards = page_content(replace(diagnosis, causes=(cause, sure)))["comparison"]["causes"]
    assert [card["clause"].startswith("If this is the cause: ") for card in cards] == [True, False]
    cards = page_content(replace(diagnosis, alternatives=()))["comparison"]["causes"]
    assert cards[0]["clause"].startswith("If this is the cause: ")

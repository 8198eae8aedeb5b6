"""A diagnosis as gap_report.json, as a page, and in one sentence."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_diagnosis.diagnosis import (
    Advice,
    Alternative,
    Candidate,
    Cause,
    Diagnosis,
    Finding,
    Interval,
    RunNoise,
    Trace,
    Value,
)
from mrd_diagnosis.localisation import where
from mrd_diagnosis.report import figures
from mrd_diagnosis.report.gap_file import read_gap_report, to_json
from mrd_diagnosis.report.page import content, write_gap_report
from mrd_diagnosis.report.sentences import clause, describe, human, share
from mrd_identification.json_file import read_schema
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import Problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.path import make_path

NOISE = 3.0
NAN = Interval(float("nan"))
VERDICTS = ("data_fault", "no_gap", "explained", "ambiguous", "unknown_effect")
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


def simulated(seed, effect):
    """A run of a Bouc-Wen damper with ``effect`` along a multisine under steps of current, and noise on the force."""
    random = np.random.default_rng(seed)
    time = np.arange(0, 6, 0.004)
    position, velocity, acceleration = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.7, 8e-3), (2.3, 3e-3)):
        w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        position += amplitude * np.sin(w * time + phase)
        velocity += amplitude * w * np.cos(w * time + phase)
        acceleration -= amplitude * w**2 * np.sin(w * time + phase)
    current = random.choice([0.0, 0.2, 0.4], 24).repeat(-(-len(time) // 24))[: len(time)]
    model = find_model("bouc_wen", effects=list(effect))
    named = {f"{name}.{parameter}": value for name, own in effect.items() for parameter, value in own.items()}
    theta = model.vector({"coil_lag": 0.004, **named})
    force = model.force(theta, make_path(time, position, velocity, acceleration, current))
    return Run(f"multisine_{seed}", time, position, velocity, current, force + NOISE * random.standard_normal(len(time)))


def fitted(recordings, effects):
    """Measured minus modelled force of each recording after a refit with ``effects``, and the parameters."""
    model = find_model("bouc_wen", effects=list(effects))
    free = tuple(i for i, p in enumerate(model.parameters) if p.free)
    start = model.vector({f"{name}.{p}": v for name in effects for p, v in EFFECTS[name].typical.items()})
    theta, _ = fit_least_squares(Problem(model, recordings, free, start), start, 20)
    return [r.force - r.modelled(model, theta) for r in recordings], dict(zip(model.names, map(float, theta), strict=True))


def nrmse(recordings, residuals):
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)) / np.std(np.concatenate([r.force for r in recordings])))


def about(value, relative=0.05):
    return Interval(value, value - relative * abs(value), value + relative * abs(value))


def values(effect, parameters):
    """An effect's fitted parameters as a diagnosis has them."""
    units = {p.name: p.unit for p in EFFECTS[effect].parameters}
    own = {name: value for name, value in parameters.items() if name.startswith(f"{effect}.")}
    return {name: Value(about(value), units[name.split(".")[1]]) for name, value in own.items()}


@cache
def diagnosed(verdict, effect="channel_delay"):
    """A diagnosis with this verdict, of runs with a late force channel (none for ``no_gap``)."""
    true = {} if verdict == "no_gap" else {effect: {"delay": 0.012}}
    recordings = [prepare_recording(simulated(seed, true)) for seed in (1, 2, 3)]
    noises = [RunNoise(np.full(len(r.force), NOISE), NOISE, 0.0, "residual") for r in recordings]
    chosen = {"no_gap": (), "data_fault": (), "unknown_effect": ("force_sensor_lag",)}.get(verdict, (effect,))
    before, base = fitted(recordings, ())
    after, parameters = fitted(recordings, chosen) if chosen else (before, base)
    traces = tuple(
        Trace(r, n, b, a, 0.8 * k, -0.002 * k, extrapolates="speed, 250 against 180 mm/s" if k == 2 else "")
        for k, (r, n, b, a) in enumerate(zip(recordings, noises, before, after, strict=True))
    )
    floor, first, last = (nrmse(recordings, part) for part in ([n.sigma for n in noises], before, after))
    closed = 1 - (last**2 - floor**2) / (first**2 - floor**2)
    candidates = [
        Candidate(
            (name,),
            last,
            about(max(closed - 0.11 * k, 0.02 * (5 - k)), 0.08),
            min(0.005 + 0.05 * k, 1.0),
            p,
            values(name, parameters) if name in chosen else {},
            ("coil_lag",) if k == 0 else (),
        )
        for k, (name, p) in enumerate(
            zip(
                (*(chosen or ("flow_asymmetry",)), *(n for n in EFFECTS if n not in chosen and n != "flow_asymmetry")),
                (0.9, 0.06, 0.03, *(0.001,) * 30),
                strict=False,
            )
        )
    ]
    untestable = tuple(
        replace(candidate, remark=why, smallest=smallest, nrmse=float("nan"), closed=NAN, probability=float("nan"))
        for candidate, why, smallest in (
            (candidates[-1], "the rod stays 12 mm away from any stop", ""),
            (candidates[-2], "the parameters refitted take it up wholly", "a drift of 0.4 N/s"),
        )
    )
    causes = tuple(Cause(name, 0.9, 0.005, about(closed, 0.04), values(name, parameters)) for name in chosen)
    ambiguous = verdict == "ambiguous"
    findings = [
        Finding("coverage", "remark", "3 runs, 18 s: position −11 to 11 mm, speed up to 78 mm/s, current 0 to 0.4 A"),
        Finding("quantisation", "limitation", "is read in steps of 0.8 N; use a smaller range", "multisine_2", "force"),
    ]
    if verdict == "data_fault":
        findings += [
            Finding("clipping", "fault", "42 samples stay at 981 N; widen the range", "multisine_1", "force"),
            Finding("clock", "fault", "7 % of the samples are missing; record it again", "multisine_3", "time"),
        ]
    diagnosis = Diagnosis(
        model=find_model("bouc_wen"),
        verdict=verdict,
        sentence="",
        held_out_by="leave-one-run-out",
        runs=tuple(recording.run for recording in recordings),
        seed=0,
        elapsed=9.4,
        findings=tuple(findings),
        unfitted=None if verdict == "data_fault" else 1.6 * first,
        floor=Interval(floor),
        before=about(first, 0.1) if verdict != "data_fault" else NAN,
        after=about(last, 0.03) if verdict != "data_fault" else NAN,
        closed=about(closed, 0.04) if chosen else NAN,
        ceiling=0.64,
        extrapolated=about(0.9 * closed) if chosen else None,
        where=where(recordings, noises, before, np.random.default_rng(0)),
        causes=causes if verdict in ("explained", "ambiguous") else (),
        alternatives=(Alternative("coil_lag", effect, 0.38, "closes the same part of the gap: correlation 0.97"),)
        if ambiguous
        else (),
        nearest=candidates[0] if verdict == "unknown_effect" else None,
        candidates=tuple(candidates[:15]) if verdict != "data_fault" else (),
        untestable=untestable,
        advice=Advice(
            "Steps of the coil current while the rod moves at a constant speed: a lag of the current then shows alone.",
            EXPERIMENT,
            (effect, "coil_lag"),
            0.02,
        )
        if ambiguous
        else None,
        parameters=parameters,
        effects=chosen,
        traces=traces,
        notes=("Three runs only: intervals rest on little.",),
    )
    return replace(diagnosis, sentence=describe(diagnosis))


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
    assert path.stat().st_size < 6e6
    assert "<script src=" not in path.read_text()
    markup = markup_of(path)
    assert not re.search(r"https?://|\bsrc=|url\(", markup)
    # Apostrophes are escaped in the page.
    assert diagnosis.sentence.split("'")[0] in markup
    assert ("plotly-graph-div" in markup) == (verdict != "data_fault")
    for finding in diagnosis.findings:
        assert finding.text in markup


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


def test_runs_beside_held_out_ones_are_called_what_they_are():
    found = diagnosed("explained")
    first, *others = found.traces
    told = content(replace(found, held_out_by="runs", traces=(*others, replace(first, held_out=True))))
    assert [run["judged"] for run in told["runs"]] == ["left out", "left out", "held out"]


def test_only_an_experiment_is_said_to_separate(tmp_path):
    found = diagnosed("ambiguous")
    assert "It separates " in markup_of(write_gap_report(found, tmp_path))
    advice = Advice("No run would tell them apart.", between=("channel_delay", ""))
    assert "It separates " not in markup_of(write_gap_report(replace(found, advice=advice), tmp_path))


def test_the_worst_of_a_fault_comes_first_and_no_physics(tmp_path):
    markup = markup_of(write_gap_report(diagnosed("data_fault"), tmp_path))
    assert markup.index("42 samples") < markup.index("The recordings</h2>")
    assert "Which effect" not in markup
    assert "Where the gap" not in markup


def test_a_diagnosis_of_faults_needs_no_traces(tmp_path):
    bare = replace(diagnosed("data_fault"), traces=(), where=(), parameters={}, untestable=())
    write_gap_report(bare, tmp_path)
    told = read_gap_report(tmp_path / "gap_report.json")["runs"]["fit"]
    assert [run["name"] for run in told] == [run.name for run in bare.runs]


def test_sentences():
    assert diagnosed("explained").sentence == (
        "The force channel is late by 12.0 ± 0.6 ms; adding this removes 100 % of the explainable gap."
    )
    assert diagnosed("no_gap").sentence.startswith("The gap was in the parameters: refitted, the model errs by 0.9")
    fitted_before = replace(diagnosed("no_gap"), unfitted=None)
    assert describe(fitted_before).startswith("No gap beyond the noise: the model errs by 0.9")
    assert diagnosed("data_fault").sentence == (
        "The recordings are faulty, so nothing is said of the physics. "
        "multisine_1, force: 42 samples stay at 981 N (and 1 more)."
    )
    ambiguous = diagnosed("ambiguous")
    assert ambiguous.sentence.startswith("Delay of the force channel and lag behind the coil current cannot be told")
    assert ambiguous.sentence.endswith("recording the experiment “current_steps” would separate them.")
    sensor = replace(ambiguous, advice=Advice("A second displacement sensor across the damper would tell them apart."))
    assert describe(sensor).endswith("closed; a second displacement sensor across the damper would tell them apart.")
    doubtful = replace(ambiguous, alternatives=(), advice=None)
    assert re.fullmatch(
        r"The force channel is late by 12\.0 ± 0\.6 ms; adding this removes \d+ % of the explainable gap, "
        r"but this is not certain \(\d+ %\)\.",
        describe(doubtful),
    )
    unknown = diagnosed("unknown_effect").sentence
    assert re.fullmatch(
        r"Something that is not in the catalogue: \d+ % of the excess error lies at .*; "
        r"it resembles lag of the force sensor, which would close \d+ % of the gap\.",
        unknown,
    )


def test_certain_causes_and_doubtful_ones_are_told_apart():
    diagnosis = diagnosed("ambiguous")
    certain = Cause("joint_play", 0.97, 0.005, about(0.5), {"joint_play.play": Value(about(3e-4), "m")})
    text = describe(replace(diagnosis, causes=(certain, *diagnosis.causes), advice=None))
    assert text.startswith("A joint has 0.300 ± 0.015 mm of play; beside this, delay of the force channel and lag behind")
    both = describe(replace(diagnosed("explained"), causes=(certain, *diagnosis.causes)))
    assert "of play and the force channel is late by 12.0 ± 0.6 ms; adding both removes" in both


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_has_a_phrase_of_its_own(effect):
    said = clause(effect, {f"{effect}.{p.name}": Value(about(p.upper), p.unit) for p in EFFECTS[effect].parameters})
    assert EFFECTS[effect].phrase
    assert not set("{}") & set(said)
    assert said == clause(effect, {p.name: Value(about(p.upper), p.unit) for p in EFFECTS[effect].parameters})
    assert "±" in said


def test_an_effect_without_phrase_is_said_by_its_title(monkeypatch):
    monkeypatch.setitem(EFFECTS, "joint_play", replace(EFFECTS["joint_play"], phrase=""))
    assert clause("joint_play", {"joint_play.play": Value(Interval(3e-4), "m")}) == "play in a joint (play 0.3 mm)"
    assert clause("long_gone", {}) == "long_gone"


@pytest.mark.parametrize(
    ("value", "unit", "style", "words"),
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
def test_numbers_are_written_as_a_person_writes_them(value, unit, style, words):
    assert human(value, unit, style) == words


@given(st.floats(1e-9, 1e9), st.sampled_from(["s", "m", "m/N", "N/m", "N s/m", "A", "1/A", "kg", "rad", ""]), st.booleans())
def test_numbers_keep_their_size_whatever_their_unit(value, unit, negative):
    words = human(-value if negative else value, unit)
    number, _, written = words.partition(" ") if unit != "rad" else (words[:-1], "", "°")
    prefix = {"µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6, "G": 1e9, "g": 1e-3}
    base = unit.partition(" ")[0].partition("/")[0]
    head = written.partition("/")[0].partition("·")[0].removeprefix("per ")
    factor = np.pi / 180 if unit == "rad" else prefix[head[0]] if head not in (base, "") and head[0] in prefix else 1.0
    if written.startswith("per "):
        factor = 1 / prefix[head[0]] if head[0] in prefix and len(head) > 1 else 1.0
    assert float(number.replace("\u2212", "-")) * factor == pytest.approx(-value if negative else value, rel=5e-3)


def test_shares():
    assert share(0.931) == "93 %"
    assert share(Interval(0.931, 0.88, 0.96)) == "93 % (88 to 96)"
    assert share(float("nan")) == "–"


def test_reading_something_else_is_one_line(tmp_path):
    file = tmp_path / "gap_report.json"
    with pytest.raises(InputError, match=r"gap_report\.json: cannot be read"):
        read_gap_report(file)
    for text, words in (
        ("{", "is not JSON"),
        ("[1]", "its schema is None, expected a gap_report.json of mrd-gap/1"),
        ('{"schema": "mrd-fit/3"}', "its schema is mrd-fit/3, expected"),
        ('{"schema": "mrd-gap/1"}', "'sentence' is a required property; expected a gap_report.json"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=words) as refused:
            read_gap_report(file)
        assert "\n" not in str(refused.value)
    content = to_json(diagnosed("explained"))
    content["causes"][0]["probability"] = 1.5
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"causes/0/probability: 1\.5 is greater than the maximum of 1; expected"):
        read_gap_report(file)


def test_the_schema_leaves_nothing_unsaid():
    for name, part in read_schema("mrd_diagnosis", "gap_report")["properties"].items():
        assert part, name
    with pytest.raises(jsonschema.ValidationError, match="verdict"):
        jsonschema.validate(
            {k: v for k, v in to_json(diagnosed("no_gap")).items() if k != "verdict"},
            read_schema("mrd_diagnosis", "gap_report"),
        )


def test_the_run_that_tells_most_is_shown_where_it_tells_most():
    diagnosis = diagnosed("explained")
    told = figures.telling(diagnosis.traces)
    gains = [np.sum(trace.before**2 - trace.after**2) for trace in diagnosis.traces]
    assert told is diagnosis.traces[int(np.argmax(gains))]
    recording = told.recording
    sudden = np.zeros(len(told.before))
    sudden[700:720] = 50.0
    shown = figures.window(replace(told, before=sudden, after=0 * sudden), 0.5)
    first, last = shown[0] - recording.counted.start, shown[-1] - recording.counted.start
    assert first <= 700
    assert last >= 719
    loops = figures.loops(told, "with the cause")
    measured, refitted, after = (trace.y for trace in loops[0].data)
    assert np.sqrt(np.mean((measured - after) ** 2)) == pytest.approx(NOISE, rel=0.2)
    assert np.sqrt(np.mean((measured - refitted) ** 2)) > 3 * NOISE


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
    plots = done.stdout.count('class="plotly-graph-div')
    assert done.stdout.count('class="main-svg"') >= plots
    assert plots == {"data_fault": 0, "no_gap": 8}.get(verdict, 9)

"""A low-pass filter that the recorded force has passed is part of what is fitted."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_identification import Method, identify
from mrd_identification.cli.identify import main
from mrd_identification.fit import evaluate_model
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.low_pass import filter_notes, known_force_filter, parse_low_pass, with_force_filter
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run, read_run, read_runs
from mrd_sim.damper import Damper
from mrd_sim.models import find_model
from mrd_sim.simulate import simulate_run

WORDS = [
    "lowpass:4",
    "lowpass:4:1",
    "lowpass:4:4",
    "lowpass:4:zero-phase",
    "lowpass:4:4:zero-phase",
    "average:0.15",
    "average:0.15:past",
]
METHOD = Method(population=12, generations=3, profile=False)


def run_of(word: str = "", frequency: float = 1.3, seed: int = 0) -> Run:
    """A damper along a sine with a force that was filtered, but nothing says so."""
    rng = np.random.default_rng(seed)
    time = np.arange(1000) / 200
    angle = 2 * np.pi * frequency * time
    x, v = 0.012 * np.sin(angle), 0.012 * 2 * np.pi * frequency * np.cos(angle)
    still = Run(f"sine_{frequency:g}hz", time, x, v, np.full(len(time), 0.2), x)
    run = simulate_run(still, Damper("bouc_wen", {"yield_force": 200.0, "viscous": 900.0, "viscous_per_A": 0.0}))
    run = replace(run, name=still.name)
    force = run.force + rng.normal(0, 1.5, len(time))
    return replace(run, force=parse_low_pass(word).filtered(force, run.rate) if word else force)


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("frequency", [0.5, 2.0, 4.0])
def test_a_filter_does_to_an_oscillation_what_its_response_says(word, frequency):
    low_pass, time = parse_low_pass(word), np.arange(4000) / 500
    wave = np.exp(2j * np.pi * frequency * time)
    expected = low_pass.response(np.array([frequency]))[0] * np.exp(-2j * np.pi * frequency * low_pass.delay)
    # The mean of an even number of samples is half a sample late or early.
    assert (low_pass.filtered(wave, 500.0) / wave)[1500:2500].mean() == pytest.approx(expected, abs=0.02)
    assert low_pass.word == word


@pytest.mark.parametrize("word", ["lowpass", "lowpass:x", "lowpass:0", "lowpass:5:3", "average:0.3:zero-phase", "butter:5"])
def test_a_word_that_is_no_filter_is_refused_with_the_grammar(word):
    with pytest.raises(InputError, match=r"expected lowpass:HZ.*average:SECONDS"):
        parse_low_pass(word)


def test_a_filter_that_the_run_cannot_have_passed_is_refused():
    with pytest.raises(InputError, match=r"sine_1\.3hz.*120 Hz.*less than half the sampling rate, 100 Hz"):
        with_force_filter(run_of(), "lowpass:120")
    with pytest.raises(InputError, match="shorter than the run"):
        with_force_filter(run_of(), "average:20")


@pytest.mark.parametrize("word", ["lowpass:4:4", "lowpass:4:zero-phase", "average:0.15"])
def test_the_damper_is_found_behind_the_filter(word):
    run = run_of(word)
    plain = identify([run], "bouc_wen", method=METHOD)
    fit = identify([with_force_filter(run, word)], "bouc_wen", method=METHOD)
    assert fit.pooled_fitted.nrmse < 0.02
    assert fit.pooled_fitted.nrmse < 0.3 * plain.pooled_fitted.nrmse
    assert fit.values["viscous"] == pytest.approx(900.0, rel=0.05)
    assert any(word in warning and run.name in warning for warning in fit.warnings)


def test_only_the_held_out_run_may_be_filtered():
    runs, filtered = [run_of(), run_of(frequency=0.7)], run_of("average:0.15", 2.1)
    errors = [
        identify(runs, "bouc_wen", held_out=[each], method=METHOD).pooled_held_out.nrmse
        for each in (filtered, with_force_filter(filtered, "average:0.15"))
    ]
    assert errors[1] < 0.02 < 0.2 < errors[0]


def test_the_error_on_the_filtered_earthquake_halves_with_its_filter():
    folder = Path(os.environ.get("MRD_DATA", Path(__file__).resolve().parents[4] / "shared/data")) / "utfsm"
    if not folder.exists():
        pytest.skip("no measured runs; name their folder by MRD_DATA")
    sines = read_runs(sorted(folder.glob("sine_25mm_0.*hz_0.*A.csv"))[::2])
    quake = read_run(folder / "quake_0.6A_prefiltered.csv")
    problem, _ = make_problem(find_model("bouc_wen"), [prepare_recording(run) for run in sines])
    theta, _ = fit_least_squares(problem, problem.theta(np.full(len(problem.free), 0.3)))
    plain, filtered = (
        evaluate_model(problem.model, theta, [prepare_recording(run)])[0].metrics.nrmse
        for run in (quake, with_force_filter(quake, "average:0.3"))
    )
    assert plain > 0.5
    assert filtered < 0.65 * plain


def test_derivatives_pass_the_filter():
    recording = prepare_recording(with_force_filter(run_of("lowpass:4"), "lowpass:4"))
    problem, _ = make_problem(find_model("bouc_wen"), [recording])
    unit = problem.unit(problem.theta(np.full(len(problem.free), 0.4)))
    step = 1e-6 * np.eye(len(unit))
    differences = [problem.residuals(problem.theta(unit + d)) - problem.residuals(problem.theta(unit - d)) for d in step]
    np.testing.assert_allclose(problem.jacobian(unit), np.stack(differences, 1) / 2e-6, rtol=1e-4, atol=1e-2)
    projected, norms = problem.project(problem.theta(unit)[None])
    assert norms[0, 0] == pytest.approx(problem.norms(projected)[0, 0])


def test_the_option_names_runs_or_means_all(tmp_path, monkeypatch, capsys):
    files = []
    for number, frequency in enumerate((0.7, 1.3)):
        run = run_of("lowpass:4", frequency)
        files.append(tmp_path / f"sine_{number}.csv")
        table = np.stack([run.time, run.position, run.current, run.force], axis=1)
        np.savetxt(files[-1], table, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
    common = ["identify", *map(str, files), "--model", "bingham", "--population", "12", "--generations", "2", "--no-profile"]

    def printed(*options: str) -> str:
        monkeypatch.setattr(sys, "argv", [*common, *options, "--output", str(tmp_path / "fit")])
        main()
        return capsys.readouterr().out

    assert "sine_0, sine_1 has passed a low-pass filter (lowpass:4)" in printed("--force-filter", "lowpass:4")
    assert "force of sine_1 has passed" in printed("--force-filter", "sine_1=lowpass:4")
    with pytest.raises(SystemExit):
        printed("--force-filter", "other=lowpass:4")
    assert "expected the name of a run: sine_0, sine_1" in capsys.readouterr().err


def test_without_a_filter_nothing_is_said():
    assert filter_notes([run_of()]) == []
    assert known_force_filter(run_of()) is None

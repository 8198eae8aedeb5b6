"""A diagnosis of seven runs of 15 s at 500 Hz against the whole catalogue, and each candidate's share of the time.

The peer is scipy's `least_squares` (trf, its own differences) on the same white residual from the same start: what a
candidate's refit would take with it, without leaving folds out.
"""

import resource
import time

import numpy as np
from common import console, describe_machine, format_duration
from rich.table import Table
from scipy.optimize import least_squares

from mrd_diagnosis import diagnose
from mrd_diagnosis.fitting.base_fit import LinearisedRefit, global_fit, with_effect
from mrd_diagnosis.fitting.refit import refit
from mrd_diagnosis.fitting.weighting import Weighting, usual_run_scatter
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.search.effect_search import score_effect
from mrd_identification.needs import needs_met
from mrd_identification.parallel import in_threads
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

MODEL = "bouc_wen"
RUNS = (
    "rod: {waveform: multisine, amplitude_mm: 15, lowest_hz: 0.2, highest_hz: 6, period_s: 15, rolloff: 1.5, seed: 0}\n"
    "coil: {waveform: aprbs, low_mA: 0, high_mA: 320, shortest_s: 0.03, longest_s: 0.3, count: 12, seed: 1}",
    "rod: {waveform: sine, amplitude_mm: 25, frequency_hz: 0.2}\ncoil: {waveform: constant, level_mA: 0}",
    "rod: {waveform: triangle, amplitude_mm: 20, slope_mm_per_s: 30}\n"
    "coil: {waveform: staircase, levels_mA: [0, 130, 260, 390, 260, 130], hold_s: 0.3}",
    "rod: {waveform: sine, amplitude_mm: 5, frequency_hz: 3}\n"
    "coil: {waveform: prbs, low_mA: 50, high_mA: 300, bit_s: 0.1, order: 7, seed: 2}",
    "rod: {waveform: chirp, amplitude_mm: 2, start_hz: 0.5, end_hz: 8}\ncoil: {waveform: constant, level_mA: 200}",
    "rod: {waveform: triangle, amplitude_mm: 10, slope_mm_per_s: 100}\n"
    "coil: {waveform: prbs, low_mA: 0, high_mA: 350, bit_s: 0.06, order: 8, seed: 3}",
    "rod: {waveform: triangle, amplitude_mm: 20, slope_mm_per_s: 8}\ncoil: {waveform: constant, level_mA: 150}",
)
DAMPERS = ("", "coil_lag", "moving_mass", "backlash", "gas_spring")
"""Effects of the dampers that are diagnosed; one has none."""


def recorded(effect: str) -> list[Run]:
    """Record the seven runs of a damper."""
    settings = read_settings(None)
    texts = [f"name: run_{place}\nduration_s: 15\nrate_hz: 500\n{text}" for place, text in enumerate(RUNS)]
    plans = [plan(parse_experiment(text, "run"), settings.limits, settings.force_envelope) for text in texts]
    effects = {effect: EFFECTS[effect].typical} if effect else None
    return measure_plans(plans, Damper(MODEL, {"coil_lag": 0.0}, effects=effects), np.random.default_rng(0))


def candidates(runs: list[Run]) -> Table:
    """Measure the time of each candidate's refit, and of the peer's."""
    recordings = in_threads(prepare_recording, runs)
    base = find_model(MODEL)
    problem, _ = make_problem(base, recordings, fixed={"coil_lag": 0.0})
    theta = global_fit(problem, None, np.random.default_rng(0))
    noise = estimate_noise(recordings, base, theta, np.random.default_rng(0))
    weighting = Weighting(recordings, noise, usual_run_scatter(base.scales), {"coil_lag": 0.0}).updated(base, theta)
    base_fit = LinearisedRefit.around(weighting, refit(weighting.problem(base, theta), theta, weighting.folds))
    table = Table("candidate", box=None)
    for title in ("score", "refit and folds left out", "scipy, refit only", "ratio"):
        table.add_column(title, justify="right")
    met = needs_met(recordings)
    for name, effect in EFFECTS.items():
        if effect.structural or not all(met[need] for need in effect.needs):
            continue
        model, neutral = with_effect(base, theta, name)
        problem = weighting.problem(model, neutral)
        began = time.perf_counter()
        start = score_effect(problem, base_fit, effect).start
        scored = time.perf_counter()
        refit(weighting.problem(model, start), start, weighting.folds)
        fitted = time.perf_counter()
        unit = np.clip(problem.unit(start), 1e-9, 1 - 1e-9)
        least_squares(lambda at, p=problem: p.residuals(p.theta(at)), unit, bounds=(0, 1), ftol=1e-6)
        peer = time.perf_counter() - fitted
        table.add_row(
            name,
            format_duration(scored - began),
            format_duration(fitted - scored),
            format_duration(peer),
            f"{peer / (fitted - scored):.1f}",
        )
    return table


def main() -> None:
    """Measure and print."""
    console.print(f"[b]Diagnosis[/b], {describe_machine()}")
    table = Table("effect of the damper", box=None)
    for title in ("samples", "verdict", "named", "time"):
        table.add_column(title, justify="right")
    times = []
    for effect in ("warm-up", *DAMPERS):
        runs = recorded("" if effect == "warm-up" else effect)
        began = time.perf_counter()
        diagnosis = diagnose(runs, MODEL)
        times.append(time.perf_counter() - began)
        named = ", ".join(cause.effect for cause in diagnosis.causes)
        table.add_row(effect or "none", str(sum(map(len, runs))), diagnosis.verdict, named, format_duration(times[-1]))
    console.print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    median, longest = format_duration(float(np.median(times[1:]))), format_duration(max(times[1:]))
    console.print(f"median {median}, longest {longest}, memory {peak:.2f} GiB")
    console.print(candidates(recorded("moving_mass")))


if __name__ == "__main__":
    main()

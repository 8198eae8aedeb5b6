"""Time of a diagnosis of seven runs of 15 s at 500 Hz with all effects of the catalogue, and of each candidate's refit.

Each refit is compared with scipy's `least_squares` (trf, finite differences) on the same white residuals from the same
start, which does not leave out parts of the recordings as the refit does.
"""

import resource
import time

import numpy as np
from common import console, describe_machine, format_duration
from rich.table import Table
from scipy.optimize import least_squares

from mrd_diagnosis import diagnose
from mrd_diagnosis.effect_search import Foundation, score
from mrd_diagnosis.model_comparison import FIRST_SCATTER
from mrd_diagnosis.noise_model import run_noise
from mrd_diagnosis.refit import refit
from mrd_diagnosis.weighting import Ground, first_fit, with_effect
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
"""Effects of the dampers that are diagnosed; the first damper has none."""


def recorded(effect: str) -> list[Run]:
    """Simulate the seven runs of a damper."""
    settings = read_settings(None)
    texts = [f"name: run_{place}\nduration_s: 15\nrate_hz: 500\n{text}" for place, text in enumerate(RUNS)]
    plans = [plan(parse_experiment(text, "run"), settings.limits, settings.force_envelope) for text in texts]
    effects = {effect: EFFECTS[effect].typical} if effect else None
    return measure_plans(plans, Damper(MODEL, {"coil_lag": 0.0}, effects=effects), np.random.default_rng(0))


def candidates(runs: list[Run]) -> Table:
    """Measure the time of each candidate's refit, by the diagnosis and by scipy."""
    recordings = in_threads(prepare_recording, runs)
    base = find_model(MODEL)
    base_problem, _ = make_problem(base, recordings, fixed={"coil_lag": 0.0})
    theta = first_fit(base_problem, None, np.random.default_rng(0))
    noises = run_noise(recordings, base, theta, np.random.default_rng(0))
    ground = Ground(recordings, noises, FIRST_SCATTER, {"coil_lag": 0.0}).after(base, theta)
    foundation = Foundation.of(ground, refit(ground.problem(base, theta), theta, ground.parts))
    table = Table("candidate", box=None)
    for title in ("score", "refit and parts left out", "scipy, refit only", "ratio"):
        table.add_column(title, justify="right")
    for name, effect in EFFECTS.items():
        if effect.structural:
            continue
        model, neutral = with_effect(base, theta, name)
        problem = ground.problem(model, neutral)
        began = time.perf_counter()
        start = score(problem, foundation, effect).start
        scored = time.perf_counter()
        refit(ground.problem(model, start), start, ground.parts)
        fitted = time.perf_counter()
        unit = np.clip(problem.unit(start), 1e-9, 1 - 1e-9)
        least_squares(lambda at, p=problem: p.residuals(p.theta(at)), unit, bounds=(0, 1), ftol=1e-6)
        with_scipy = time.perf_counter() - fitted
        table.add_row(
            name,
            format_duration(scored - began),
            format_duration(fitted - scored),
            format_duration(with_scipy),
            f"{with_scipy / (fitted - scored):.1f}",
        )
    return table


def main() -> None:
    """Print the tables."""
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
        causes = ", ".join(cause.effect for cause in diagnosis.causes)
        table.add_row(effect or "none", str(sum(map(len, runs))), diagnosis.verdict, causes, format_duration(times[-1]))
    console.print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    median, longest = format_duration(float(np.median(times[1:]))), format_duration(max(times[1:]))
    console.print(f"median {median}, longest {longest}, memory {peak:.2f} GiB")
    console.print(candidates(recorded("moving_mass")))


if __name__ == "__main__":
    main()

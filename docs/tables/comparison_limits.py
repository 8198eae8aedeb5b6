"""What limits the prediction of held-out runs: `python docs/tables/comparison_limits.py FIT.json RUN... --figure FILE.png`.

Prints the table of docs/comparison.md for these runs, and draws their force and its error. The fit must have constant,
affine or quadratic current laws, and every run a constant current.
"""

import argparse
import itertools

import matplotlib
import numpy as np

from mrd_identification import load_damper, read_fit
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import read_runs

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HEADER = ("run", "std of force, N", "predicted", "own offset and gain", "own parameters", "scatter of cycles")
USUAL = 0.03
"""Relative deviation of the duration and of the stroke of a usual cycle, at most."""

FEWEST_CYCLES = 3
"""Usual cycles of which a scatter is computed."""

PHASES = np.linspace(0.0, 1.0, 200, endpoint=False)


def nrmse(error, force):
    """Return the rms of an error over the standard deviation of the force, both (n,) in N."""
    return float(np.sqrt(np.mean(error**2)) / np.std(force))


def own_parameters(damper, recording):
    """Return the modelled force (n,) in N with parameters fitted to this run alone, from those of the fit at its current."""
    model, current = damper.model, float(recording.run.current.mean())
    problem, _ = make_problem(model, [recording])
    values = dict(zip(model.names, damper.theta, strict=True))
    for index, name in enumerate(model.names):
        at_current = values[name] + values.get(f"{name}_per_A", 0.0) * current
        at_current += values.get(f"{name}_per_A2", 0.0) * current**2
        if index in problem.free:
            problem.base[index] = np.clip(at_current, model.parameters[index].lower, model.parameters[index].upper)
    theta, _ = fit_least_squares(problem, problem.base)
    return recording.modelled(model, theta)


def cycle_scatter(recording):
    """Return how much the force at the same phase differs from cycle to cycle, over the standard deviation of the force.

    Cycles begin at the lower reversals; those whose duration or stroke is not the usual one are left out. nan with too few.
    """
    time, velocity, position = recording.run.time, recording.motion.velocity, recording.motion.position
    rising = np.flatnonzero((velocity[:-1] < 0) & (velocity[1:] >= 0))
    starts = time[rising] - velocity[rising] * np.diff(time)[rising] / np.diff(velocity)[rising]
    stroke = np.array([np.ptp(position[a:b]) for a, b in itertools.pairwise(rising)])
    usual = stroke > 0.5 * stroke.max()  # while the rod rests or trembles there are reversals, too
    for size in (np.diff(starts), stroke):
        usual &= np.abs(size / np.median(size[stroke > 0.5 * stroke.max()]) - 1.0) < USUAL
    cycles = [cycle for cycle, keep in zip(itertools.pairwise(starts), usual, strict=True) if keep]
    forces = np.array([np.interp(start + PHASES * (end - start), time, recording.run.force) for start, end in cycles])
    if len(forces) < FEWEST_CYCLES:
        return float("nan")
    return float(np.sqrt(np.mean(np.var(forces, axis=0, ddof=1))) / np.std(recording.force))


def main():
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fit")
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--figure", required=True)
    arguments = parser.parse_args()
    damper = load_damper(arguments.fit)
    laws = set(read_fit(arguments.fit).laws.values())
    if not laws <= {"constant", "affine", "quadratic"}:
        parser.error(
            f"{arguments.fit}: its current laws are {', '.join(sorted(laws))}, expected constant, affine or quadratic"
        )
    recordings = [prepare_recording(run) for run in read_runs(arguments.runs)]
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    figure, axes = plt.subplots(len(recordings), 3, figsize=(15, 3.6 * len(recordings)), squeeze=False)
    for recording, (loop, over_velocity, over_position) in zip(recordings, axes, strict=True):
        force, modelled = recording.force, recording.modelled(damper.model, damper.theta)
        error = force - modelled
        columns = np.stack([modelled, np.ones_like(modelled)], axis=1)
        adapted = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
        own = force - own_parameters(damper, recording)
        cells = [nrmse(e, force) for e in (error, adapted, own)] + [cycle_scatter(recording)]
        print(
            f"| {recording.run.name} | {np.std(force):.0f} | {' | '.join(f'{100 * cell:.1f} %' for cell in cells)} |",
            flush=True,
        )
        velocity, position = (s[recording.counted] for s in (recording.motion.velocity, 1e3 * recording.motion.position))
        loop.plot(velocity, force, ".", ms=1.5, color="#1f2933", label="measured")
        loop.plot(velocity, modelled, ".", ms=1.0, color="#d1495b", label="predicted")
        over_velocity.plot(velocity, error, ".", ms=1.5, color="#1f2933", label="of the prediction")
        over_velocity.plot(velocity, own, ".", ms=1.0, color="#2a9d8f", label="with own parameters")
        over_position.plot(position, error, ".", ms=1.5, color="#1f2933")
        over_position.plot(position, own, ".", ms=1.0, color="#2a9d8f")
        loop.set(title=f"{recording.run.name}: NRMSE {100 * cells[0]:.1f} %", xlabel="velocity, m/s", ylabel="force, N")
        over_velocity.set(title="measured minus modelled force", xlabel="velocity, m/s", ylabel="error, N")
        over_position.set(title="measured minus modelled force", xlabel="position, mm", ylabel="error, N")
        for axis in (loop, over_velocity):
            axis.legend(markerscale=6, fontsize=8)
    figure.tight_layout()
    figure.savefig(arguments.figure, dpi=70)


if __name__ == "__main__":
    main()

"""The damper's answer to an experiment or to a recorded motion, without a bench around it."""

from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs import Run
from mrd_runs.motion import motion
from mrd_sim.damper import Damper
from mrd_sim.path import make_path, path_of
from mrd_trajectory.plan import Plan


def simulate_run(run: Run, damper: Damper) -> Run:
    """Replace the force of a run by that of a damper along its (smoothed) motion and measured current."""
    moved = motion(run)
    force = damper.model.force(damper.theta, path_of(run))
    return Run(
        f"{run.name}_{damper.model.id}", run.time, moved.position, moved.velocity, run.current, force, moved.acceleration,
        info={"source": f"{damper.description} along {run.name}"},
    )


def simulate_plan(plan: Plan, damper: Damper) -> Run:
    """Simulate a damper along the setpoints of a plan, as if rod and coil followed them exactly.

    It is integrated at 1 kHz at least, so that steps of the current are steps, and sampled at the experiment's rate.
    """
    steps = int(np.ceil(1000 / plan.experiment.rate))
    samples = slice(None, None, steps)
    time = np.arange((len(plan.times()) - 1) * steps + 1) / (steps * plan.experiment.rate)
    at = plan.at(time)
    path = make_path(time, at.position, at.velocity, at.acceleration, at.current)
    force = damper.model.force(damper.theta, path)
    return Run(
        f"{plan.experiment.name}_{damper.model.id}", time[samples], at.position[samples], at.velocity[samples],
        at.current[samples], force[samples], at.acceleration[samples],
        info={"source": f"{damper.description} along the setpoints of {plan.experiment.name}"},
    )


def write_csv(run: Run, path: str | Path) -> None:
    """Write a run as CSV that `mrd_runs.read_run` reads back; refuses to overwrite."""
    columns = {
        "time_s": run.time,
        "position_m": run.position,
        "current_A": run.current,
        "force_N": run.force,
        "velocity_mps": run.velocity,
    }
    if run.acceleration is not None:
        columns["acceleration_mps2"] = run.acceleration
    try:
        with Path(path).open("x", encoding="utf-8") as stream:
            np.savetxt(stream, np.stack(list(columns.values()), axis=1), "%.12g", ",", header=",".join(columns), comments="")
    except FileExistsError:
        raise InputError(f"{path}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None

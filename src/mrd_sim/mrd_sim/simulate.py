"""The damper's answer to an experiment or to a recorded motion, without a bench around it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs import Run
from mrd_runs.motion import motion
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_trajectory.plan import Plan


def simulate_run(run: Run, model: str, values: Mapping[str, float]) -> Run:
    """Replace the force of a run by that of a model along its (smoothed) motion and measured current.

    Parameters
    ----------
    run : Run
    model : str
        Id of a damper model.
    values : mapping
        Parameters by name; those not given keep the model's default.

    Raises
    ------
    InputError
        For an unknown model or parameter, or a value out of bounds.
    """
    damper = find_model(model)
    moved = motion(run)
    path = make_path(run.time, moved.position, moved.velocity, moved.acceleration, run.current)
    force = damper.force(damper.vector(values), path)
    return Run(
        f"{run.name}_{model}", run.time, moved.position, moved.velocity, run.current, force, moved.acceleration,
        info={"source": f"{model} along {run.name}"},
    )


def simulate_plan(plan: Plan, model: str, values: Mapping[str, float], rate: float | None = None) -> Run:
    """Simulate a model along the setpoints of a plan, as if rod and coil followed them exactly.

    ``rate`` in Hz is that of the experiment unless given.
    """
    damper = find_model(model)
    rate = plan.experiment.rate if rate is None else rate
    time = np.arange(int(plan.duration * rate) + 1) / rate
    at = plan.at(time)
    path = make_path(time, at.position, at.velocity, at.acceleration, at.current)
    force = damper.force(damper.vector(values), path)
    return Run(
        f"{plan.experiment.name}_{model}", time, at.position, at.velocity, at.current, force, at.acceleration,
        info={"source": f"{model} along the setpoints of {plan.experiment.name}"},
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

"""The force of a damper along an experiment or a recorded motion, without a bench."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
import scipy
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.quantities import ZERO_CELSIUS
from mrd_runs import Run, make_run
from mrd_runs.signals.smoothed_run import smooth_run
from mrd_sim.damper import Damper
from mrd_sim.heating import Heating
from mrd_sim.path import Path, make_path, run_path
from mrd_trajectory.plan import Plan

Array = NDArray[np.float64]

INTEGRATION_RATE = 4000.0
"""Hz. `measure_plan` integrates at this rate or at the next multiple of the experiment's rate."""
LEAST_RATE = 1000.0
"""Hz. `simulate_plan` integrates at this rate at least, so that steps of the current are steps."""


@dataclass(frozen=True)
class Instruments:
    """Sensors and supply, through which a damper is recorded.

    The defaults are those of the simulated bench in round numbers, with the noise of a bench that is wired with some care.

    Attributes
    ----------
    position_noise, force_noise, current_noise, acceleration_noise, temperature_noise : float
        m, N, A, m/s², K rms of every sample; white.
    acceleration_gain, acceleration_offset : float
        Error of the accelerometer: relative, and in m/s².
    bandwidth : float
        Hz, -3 dB of the first-order anti-alias filter, the same for all channels; infinite for none.
    supply_lag : float
        s, first-order lag from the commanded current to that in the coil.
    run_gain, run_offset : float
        Scatter of the force from run to run though nothing has changed: standard deviations of its scale, relative, and of
        its zero in N.
    """

    position_noise: float = 8e-6
    force_noise: float = 1.5
    current_noise: float = 0.004
    acceleration_noise: float = 0.05
    acceleration_gain: float = 0.01
    acceleration_offset: float = 0.02
    bandwidth: float = 250.0
    supply_lag: float = 0.003
    temperature_noise: float = 0.2
    run_gain: float = 0.01
    run_offset: float = 2.0


def simulate_run(run: Run, damper: Damper) -> Run:
    """Replace the force of a run by that of a damper along its (smoothed) motion and measured current."""
    smoothed = smooth_run(run)
    motion = smoothed.motion
    force = damper.model.force(damper.theta, run_path(smoothed))
    return Run(
        f"{run.name}_{damper.model.id}",
        run.time,
        motion.position,
        motion.velocity,
        run.current,
        force,
        motion.acceleration,
        run.temperature,
        info={"source": f"{damper.description} along {run.name}"},
    )


def simulate_plan(plan: Plan, damper: Damper) -> Run:
    """Simulate a damper along the setpoints of a plan, as if rod and coil followed them exactly.

    The force is integrated at `LEAST_RATE` or more and sampled at the experiment's rate. A damper whose effects depend on
    its temperature starts at that of the room and warms up by the power that it dissipates, as `Heating` has it by default.
    """
    steps = int(np.ceil(LEAST_RATE / plan.experiment.rate))
    samples = slice(None, None, steps)
    time = np.arange((len(plan.times()) - 1) * steps + 1) / (steps * plan.experiment.rate)
    at = plan.at(time)
    path = make_path(time, at.position, at.velocity, at.acceleration, at.current)
    model = damper.model
    if model.needs_temperature:
        path = warmed_path(path, damper, model.initial_state(path), Heating(), Heating().ambient_kelvin)
    force = model.force(damper.theta, path)
    return Run(
        f"{plan.experiment.name}_{damper.model.id}",
        time[samples],
        at.position[samples],
        at.velocity[samples],
        at.current[samples],
        force[samples],
        at.acceleration[samples],
        None if path.temperature is None else path.temperature[path.samples][samples],
        info={"source": f"{damper.description} along the setpoints of {plan.experiment.name}"},
    )


def warmed_path(path: Path, damper: Damper, state: Array, heating: Heating, start: float) -> Path:
    """Return a path with the temperature of a damper that warms up along it by the power that it dissipates.

    The power is that of a damper that stays at the temperature at the start: what heat takes from the force changes the heat
    to second order.

    Parameters
    ----------
    path : Path
    damper : Damper
    state : ndarray
        Of its model at the start; not changed.
    heating : Heating
    start : float
        Temperature at the start in K.
    """
    cold = replace(path, temperature=np.full(len(path.dt), start), samples=np.arange(len(path.dt)))
    force, _ = damper.model.forces(damper.theta, cold, state.copy())
    # On equal steps, which the vertices at reversals divide.
    time = np.cumsum(path.dt)
    even = np.linspace(time[0], time[-1], len(time))
    power = np.interp(even, time, force * path.velocity)
    temperature = np.append(start, heating.warmed(start, power[1:], float(even[1] - even[0])))
    return replace(path, temperature=np.interp(time, even, temperature))


def measure_plan(
    plan: Plan,
    damper: Damper,
    rng: np.random.Generator,
    *,
    instruments: Instruments | None = None,
    heating: Heating | None = None,
) -> Run:
    """Return a plan as a bench would have recorded it with a fresh damper; see `measure_plans`."""
    return measure_plans([plan], damper, rng, instruments=instruments, heating=heating)[0]


def measure_plans(
    plans: Sequence[Plan],
    damper: Damper,
    rng: np.random.Generator,
    *,
    instruments: Instruments | None = None,
    heating: Heating | None = None,
) -> list[Run]:
    """Return plans as a bench would have recorded them, one after the other.

    Rod and coil follow their setpoints, the coil with the lag of its supply. As in the simulated bench, every sample is the
    mean of the anti-alias filter's output since the sample before. Heat, settling and drift go on from run to run.

    Parameters
    ----------
    plans : sequence of Plan
    damper : Damper
        A fresh damper, which is not changed. The motion of the setpoints is the measured one; drive effects lead from it to
        the motion of the damper, as everywhere.
    rng : numpy Generator
        Source of noise and run scatter. A run does not depend on those after it.
    instruments : Instruments, optional
    heating : Heating, optional
        How the damper warms up by the power that it dissipates; its temperature is recorded, and goes on from run to run.
        Without it, there is a thermometer only where effects of the damper depend on the temperature.

    Returns
    -------
    list of Run
        With the names and the rates of their experiments; each begins and ends at rest at mid-stroke.
    """
    instruments = instruments or Instruments()
    model, state = damper.model, None
    if model.needs_temperature:
        heating = heating or Heating()
    temperature = heating.ambient_kelvin if heating else 0.0
    runs = []
    for plan in plans:
        (run_rng,) = rng.spawn(1)
        rate = plan.experiment.rate
        steps = math.ceil(INTEGRATION_RATE / rate)
        samples = int(plan.duration * rate)
        step = 1.0 / (steps * rate)
        time = np.arange(samples * steps) / (steps * rate)
        at = plan.at(time)
        current = _lagged(at.current, instruments.supply_lag, step)
        path = make_path(time, at.position, at.velocity, at.acceleration, current)
        state = model.initial_state(path) if state is None else model.next_state(state, path)
        if heating:
            path = warmed_path(path, damper, state, heating, temperature)
        force = model.force(damper.theta, path, state)
        filtered = _lagged(
            np.stack([at.position, force, current, at.acceleration]), 0.5 / (math.pi * instruments.bandwidth), step
        )
        position, force, current, acceleration = filtered.reshape(4, samples, steps).mean(axis=2)
        gain, offset = run_rng.normal(0.0, (instruments.run_gain, instruments.run_offset))
        columns = {
            "time_s": np.arange(samples) / rate,
            "position_m": position + run_rng.normal(0.0, instruments.position_noise, samples),
            "current_A": current + run_rng.normal(0.0, instruments.current_noise, samples),
            "force_N": (1.0 + gain) * force + offset + run_rng.normal(0.0, instruments.force_noise, samples),
            "acceleration_mps2": (1.0 + instruments.acceleration_gain) * acceleration
            + instruments.acceleration_offset
            + run_rng.normal(0.0, instruments.acceleration_noise, samples),
        }
        if path.temperature is not None:
            temperature = float(path.temperature[-1])
            measured = path.temperature[path.samples].reshape(samples, steps).mean(axis=1)
            noise = run_rng.normal(0.0, instruments.temperature_noise, samples)
            columns["temperature_C"] = measured - ZERO_CELSIUS + noise
        source = f"{damper.description} along {plan.experiment.name}, as measured"
        runs.append(make_run(plan.experiment.name, columns, {"source": source}))
    return runs


def _lagged(series: Array, lag: float, step: float) -> Array:
    """Return series (..., n) after a first-order lag in s, exact where they are linear over each ``step`` in s."""
    if lag == 0.0:
        return series
    keep = math.exp(-step / lag)
    mean = (1.0 - keep) * lag / step
    # Before the first value the series had that value.
    filtered, _ = scipy.signal.lfilter([1.0 - mean, mean - keep], [1.0, -keep], series, zi=mean * series[..., :1])
    return np.asarray(filtered, np.float64)


def write_csv(run: Run, path: str | FilePath, *, velocity: bool = True) -> None:
    """Write a run as a CSV file that `mrd_runs.read_run` reads; refuse to overwrite a file.

    Without ``velocity``, readers take the velocity from the positions, as they do where no bench has measured it.
    """
    columns = {"time_s": run.time, "position_m": run.position, "current_A": run.current, "force_N": run.force}
    if velocity:
        columns["velocity_mps"] = run.velocity
    if run.acceleration is not None:
        columns["acceleration_mps2"] = run.acceleration
    if run.temperature is not None:
        columns["temperature_C"] = run.temperature - ZERO_CELSIUS
    try:
        FilePath(path).parent.mkdir(parents=True, exist_ok=True)
        with FilePath(path).open("x", encoding="utf-8") as stream:
            np.savetxt(stream, np.stack(list(columns.values()), axis=1), "%.12g", ",", header=",".join(columns), comments="")
    except FileExistsError:
        raise InputError(f"{path}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None

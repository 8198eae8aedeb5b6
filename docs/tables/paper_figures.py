"""Draw figures 5a, 5b and 6 of the followed paper as this bench makes them: docs/paper_figures.png.

ros2 run mrd_bench_driver bench config/experiments/paper.yaml --simulated --seed 1 --output runs/paper
ros2 run mrd_identification identify runs/paper/bag --model bouc_wen --output runs/paper
python docs/tables/paper_figures.py runs/paper/bag runs/paper/fit.json
"""

import argparse
import io
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from mrd_identification.fit_file import read_fit
from mrd_identification.recording import prepare_recording
from mrd_runs import read_run
from mrd_sim.models import find_model
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings
from mrd_trajectory.waveforms.step import Step
from mrd_trajectory.waveforms.triangle import Triangle

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[2]
MEASURED, MODELLED = "#2b8cd6", "#e69f00"
SHOWN = (20.0, 24.0)
"""s of the run that the figures over time show."""


def main() -> None:
    """Draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, metavar="RUN", help="recording of config/experiments/paper.yaml")
    parser.add_argument("fit", type=Path, metavar="FIT.json", help="Bouc-Wen model that was identified from it")
    arguments = parser.parse_args()
    plt.rcParams |= {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}
    figure, axes = plt.subplots(2, 2, figsize=(9, 6), layout="constrained")
    draw_waveforms(axes[0, 0])
    draw_run(axes[0, 1], axes[1, 0], axes[1, 1], arguments.run, arguments.fit)
    content = io.BytesIO()
    figure.savefig(content, dpi=100)
    picture = Image.open(content).convert("RGB").quantize(64, dither=Image.Dither.NONE)
    picture.save(ROOT / "docs" / "paper_figures.png", optimize=True)


def draw_waveforms(axes: plt.Axes) -> None:
    """Draw the waveforms that the paper names, with its stroke and frequency, as the bench plans them within its limits."""
    experiment, settings = read_experiment(ROOT / "config/experiments/paper.yaml"), read_settings(ROOT / "config/bench.yaml")
    waveforms = {
        "sine": experiment.rod,
        "triangle": Triangle(amplitude=5e-3, slope=4 * 5e-3 * 1.5),
        "step": Step(start=-5e-3, end=5e-3, delay=1.0),
    }
    for name, rod in waveforms.items():
        planned = plan(replace(experiment, rod=rod, duration=2.0), settings.limits, settings.force_envelope)
        time = np.linspace(0, 2.0, 1000)
        axes.plot(time, 1e3 * planned.at(time).position, label=name)
    axes.set(title="5a: waveforms", xlabel="time / s", ylabel="position / mm")
    axes.legend(ncols=3, loc="upper right")
    axes.set_ylim(top=7.5)


def draw_run(over_time: plt.Axes, compared: plt.Axes, loop: plt.Axes, bag: Path, fit_file: Path) -> None:
    """Draw the measured force over time, and the modelled one beside it over time and over velocity."""
    run, fit = read_run(bag), read_fit(fit_file)
    model, recording = find_model(fit.model, fit.laws, fit.effects), prepare_recording(run)
    force = recording.as_recorded(model.force(model.vector(fit.values), recording.path))
    shown = (run.time >= SHOWN[0]) & (run.time < SHOWN[1])
    over_time.plot(run.time[shown], run.force[shown], ".-", color=MEASURED, linewidth=0.8, markersize=3)
    over_time.set(title="5b: measured force", xlabel="time / s", ylabel="force / N")
    compared.plot(run.time[shown], force[shown], color=MODELLED, linewidth=1, label="Bouc-Wen model")
    compared.plot(run.time[shown], run.force[shown], ".", color=MEASURED, markersize=4, label="measured")
    compared.set(title="6: measured and modelled force", xlabel="time / s", ylabel="force / N")
    compared.legend(ncols=2, loc="upper right")
    compared.set_ylim(top=330)
    loop.plot(1e3 * run.velocity, run.force, "o", color=MEASURED, markersize=4, fillstyle="none", markeredgewidth=0.5)
    loop.plot(1e3 * run.velocity, force, ".", color=MODELLED, markersize=2)
    loop.set(title="6: over velocity, whole run", xlabel="velocity / mm/s", ylabel="force / N")


if __name__ == "__main__":
    main()

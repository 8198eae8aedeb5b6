"""Draws docs/hybrid_test.png, the picture of a hybrid test in README.md, from its recording (`make demo-control`).

python docs/tables/hybrid_test.py runs/quarter_car_skyhook-*/bag
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt

from mrd_control.comparison import compare_with_twin
from mrd_control.recording import read_hybrid_run
from mrd_identification.figures import MEASURED, MODELLED

PICTURE = Path(__file__).resolve().parents[1] / "hybrid_test.png"
SHOWN = slice(4000, 7000)
"""Samples of the picture."""


def main() -> None:
    """Draw travel, force and current of bench and twin, and by how much the rod is off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", help="recording of the hybrid test")
    comparison = compare_with_twin(read_hybrid_run(parser.parse_args().bag))
    bench, twin = comparison.run.bench.part(SHOWN), comparison.twin.part(SHOWN)
    rows = (
        ("travel, mm", 1e3 * bench.travel, 1e3 * twin.travel),
        ("rod off by, mm", 1e3 * (bench.rod - bench.travel), None),
        ("force, N", bench.force, twin.force),
        ("current, A", bench.current, twin.current),
    )
    figure, axes = plt.subplots(len(rows), 1, figsize=(7.6, 4.6), sharex=True, layout="constrained")
    for axis, (title, measured, modelled) in zip(axes, rows, strict=True):
        axis.plot(bench.time, measured, color=MEASURED, linewidth=1.6, label="bench")
        if modelled is not None:
            axis.plot(bench.time, modelled, color=MODELLED, linewidth=0.9, linestyle="--", label="offline twin")
        axis.set_ylabel(title, fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", ncols=2, fontsize=8)
    axes[-1].set_xlabel("time, s", fontsize=8)
    figure.align_ylabels()
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()

"""Summary of a run: its origin, its length, its ranges and its noise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_runs.run import Run
from mrd_runs.signals.motion import smooth_motion

# Peak speed over the speed below which a sample counts as standstill; noise changes the sign of the velocity there.
_PEAK_OVER_STANDSTILL = 50


def summarise(run: Run) -> dict[str, str]:
    """Return a text for each item of the summary; items without content are omitted."""
    info, motion = run.info, smooth_motion(run.time, run.position, run.acceleration)
    rows = {
        "source": info.get("source", ""),
        "imported from": info.get("imported_from", ""),
        "experiment": info.get("experiment_name") or "",
        "recorded": info.get("started", ""),
        "seed": info.get("seed", ""),
        "duration": f"{run.duration:.3f} s",
        "rate": f"{run.rate:.6g} Hz",
        "samples": len(run),
        "lost": info.get("lost", 0),
        "stroke": f"{np.ptp(run.position) * 1e3:.3f} mm peak to peak",
        "peak speed": f"{np.abs(motion.velocity).max() * 1e3:.2f} mm/s",
        "reversals": count_reversals(motion.velocity),
        "force": f"{run.force.min():.2f} to {run.force.max():.2f} N",
        "current": f"{run.current.min() * 1e3:.1f} to {run.current.max() * 1e3:.1f} mA",
        "position noise": f"{motion.position_noise * 1e6:.3g} µm",
        "clocks": ""
        if run.clocks_agree()
        else "not known to agree: " + ", ".join(f"{q} {c}" for q, c in run.clocks.items()),
        "calibration": _calibration(info.get("calibration") or {}),
        "closed": "no: recovered" if info.get("recovered") else "yes",
        "notes": "\n".join(info.get("notes", ())),
    }
    return {name: str(content) for name, content in rows.items() if str(content)}


def count_reversals(velocity: NDArray[np.float64]) -> int:
    """Return the number of changes of the direction of motion."""
    moving = np.abs(velocity) > np.abs(velocity).max() / _PEAK_OVER_STANDSTILL
    return int(np.count_nonzero(np.diff(np.sign(velocity[moving]))))


def _calibration(calibration: dict[str, Any]) -> str:
    channels = [
        f"{name}: {entry['gain']:.6g} {entry['unit']}/V from {entry['zero_V']:.6g} V ({entry['channel']})"
        for name, entry in calibration.items()
        if isinstance(entry, dict)
    ]
    return "\n".join([*channels, *([f"device: {calibration['device']}"] if "device" in calibration else [])])


def run_json(run: Run) -> dict[str, Any]:
    """Describe a run in a JSON file."""
    return {
        "name": run.name,
        "source": str(run.info.get("source", "")),
        "samples": len(run),
        "rate_hz": run.rate,
        "duration_s": run.duration,
    }

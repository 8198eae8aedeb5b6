"""A look at a recording: its facts, its loop as a small picture, and what is wrong with it.

It takes a second or so, and is therefore made once, in a process of its own.
"""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_dashboard.live_frame import derivative
from mrd_dashboard.sample_history import Samples
from mrd_identification.preflight import preflight
from mrd_runs import Run, read_run

WIDTH, HEIGHT = 120, 60
"""Size of the picture in pixels."""
MOST_POINTS = 2000
"""Points of the series that the comparison of two runs draws."""
_PICTURE_POINTS = 600


@dataclass(frozen=True)
class Look:
    """What a look at a recording finds.

    Attributes
    ----------
    problem : str
        Why the recording cannot be read, or "".
    duration, rate : float
        In s and Hz.
    stroke, speed, force, current : float
        Largest distance between two positions in m; largest speed, force and current in m/s, N, A.
    picture : str
        Points of the loop force over velocity, for an SVG polyline of `WIDTH` by `HEIGHT`.
    experiment, started : str
        Name of the experiment, and the date at which it was started.
    findings : tuple of (str, str)
        Severity and sentence of each finding of the preflight.
    """

    problem: str = ""
    duration: float = 0.0
    rate: float = 0.0
    stroke: float = 0.0
    speed: float = 0.0
    force: float = 0.0
    current: float = 0.0
    picture: str = ""
    experiment: str = ""
    started: str = ""
    findings: tuple[tuple[str, str], ...] = ()

    @property
    def verdict(self) -> str:
        """The worst severity among the findings: "fault", "limitation", "remark", or "" for none."""
        severities = [severity for severity, _ in self.findings]
        return next((name for name in ("fault", "limitation", "remark") if name in severities), "")


def look_at(path: str) -> Look:
    """Return what a look at a recording finds; one that cannot be read has the reason as its ``problem``."""
    try:
        run = read_run(path)
        findings = tuple((finding.severity, finding.sentence) for finding in preflight([run]))
    except InputError as error:
        return Look(problem=str(error))
    velocity = velocity_of(run)
    return Look(
        duration=run.duration,
        rate=run.rate,
        stroke=float(np.ptp(run.position)),
        speed=float(np.abs(velocity).max()),
        force=float(np.abs(run.force).max()),
        current=float(np.abs(run.current).max()),
        picture=_picture(velocity, run.force),
        experiment=str(run.info.get("experiment_name") or ""),
        started=str(run.info.get("started") or ""),
        findings=findings,
    )


def velocity_of(run: Run) -> Any:
    """Return the velocity (n,) in m/s by which a run is drawn."""
    samples = Samples(np.arange(len(run)), run.time, run.position, run.force, run.current)
    return derivative(samples, 1)


def _picture(velocity: Any, force: Any) -> str:
    kept = np.linspace(0, len(force) - 1, min(_PICTURE_POINTS, len(force))).astype(int)

    def scaled(values: Any, size: float) -> Any:
        span = max(float(np.ptp(values)), np.finfo(float).tiny)
        return 2 + (size - 4) * (values - values.min()) / span

    x, y = scaled(velocity[kept], WIDTH), HEIGHT - scaled(force[kept], HEIGHT)
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def cached_look(recording: Path, cache: Path) -> Look | None:
    """Return the look at a recording that `keep_look` has kept, unless the recording has changed since."""
    try:
        content = json.loads(cache.read_text(encoding="utf-8"))
        if content.pop("of") != _fingerprint(recording):
            return None
        content["findings"] = tuple((str(severity), str(text)) for severity, text in content["findings"])
        return Look(**content)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def keep_look(look: Look, recording: Path, cache: Path) -> None:
    """Keep a look in a file."""
    cache.parent.mkdir(parents=True, exist_ok=True)
    part = cache.with_name(cache.name + ".part")
    part.write_text(json.dumps({"of": _fingerprint(recording), **dataclasses.asdict(look)}), encoding="utf-8")
    part.replace(cache)


def _fingerprint(recording: Path) -> list[list[object]]:
    """Return names, sizes and times of the files that hold the samples."""
    files = sorted(file for file in recording.iterdir() if file.suffix in (".mcap", ".db3", ".zstd"))
    return [[file.name, file.stat().st_size, file.stat().st_mtime_ns] for file in files]


def curves(path: str) -> dict[str, Any]:
    """Return the series of a recording that a comparison draws, at most `MOST_POINTS` each, in the units that people read.

    Raises
    ------
    InputError
        When the recording cannot be read.
    """
    run = read_run(path)
    kept = slice(None, None, -(-len(run) // MOST_POINTS))
    columns = {
        "time_s": run.time,
        "force_N": run.force,
        "position_mm": 1e3 * run.position,
        "current_mA": 1e3 * run.current,
        "velocity_mm_per_s": 1e3 * velocity_of(run),
    }
    return {name: np.round(column[kept], 3).tolist() for name, column in columns.items()}

"""The diagnosis of a hybrid test names what the plant has and the twin lacks; the review says what it does to the ride."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrd_control.comparison import compare_with_twin
from mrd_control.experiment import damper_entry, format_control_experiment, read_control_experiment
from mrd_control.recording import read_hybrid_run
from mrd_control.twin import run_twin
from mrd_diagnosis.diagnose import diagnose
from mrd_diagnosis.report.gap_file import write_gap_file
from mrd_identification.export import load_damper
from mrd_runs import Run, read_run
from mrd_sim.damper import Damper

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = read_control_experiment(ROOT / "config/control/hybrid_test.yaml")
EFFECTS = {"coil_lag": {"lag": 0.015, "falling": 0.3}, "series_compliance": {"compliance": 4e-7}}
ALIKE = (*EFFECTS, "channel_delay", "force_sensor_lag", "magnetic_hysteresis", "side_load_friction")
"""Effects that are tried: those of the plant, and what each is confused with."""


def with_noise(values: Any, level: float, seed: int) -> Any:
    return values + level * np.random.default_rng(seed).standard_normal(len(values))


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_in_a_closed_loop_is_named(effect: str) -> None:
    """Law and emulated system feed the force back into motion and current; the noise is ten times that of the bench."""
    entry = damper_entry(SHIPPED.damper)
    damper = Damper(entry["model"], entry["parameters"], entry["laws"], {effect: EFFECTS[effect]})
    bench = run_twin(replace(SHIPPED, damper=damper))
    position, current = with_noise(bench.rod, 5e-6, 1), with_noise(bench.current, 6.7e-3, 2)
    force = with_noise(bench.force, 3.0, 3)
    run = Run("hybrid", bench.time, position, np.gradient(position, bench.time), current, force)
    diagnosis = diagnose([run], "bouc_wen", effects=ALIKE)
    assert [cause.effect for cause in diagnosis.causes] == [effect]
    assert diagnosis.verdict == "explained"


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(900)
@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_in_the_plant_of_a_hybrid_test_is_named_and_explains_the_ride(
    whole_bench: Any, tmp_path: Path, effect: str
) -> None:
    plant = {"damper.effects": str({effect: EFFECTS[effect]}).replace("'", "")}
    with whole_bench(tmp_path, {"plant": plant}, control_cycle=SHIPPED.cycle) as bench:
        result = bench.client.run_control(format_control_experiment(SHIPPED), tmp_path / "bag", 1)
    assert result.success, result.message

    diagnosis = diagnose([read_run(tmp_path / "bag")], "bouc_wen", effects=ALIKE)
    assert [cause.effect for cause in diagnosis.causes] == [effect]
    report = write_gap_file(diagnosis, tmp_path)

    comparison = compare_with_twin(read_hybrid_run(tmp_path / "bag"), load_damper(report))
    assert comparison.explanation is not None
    assert comparison.motion > 0.01
    assert comparison.explained_motion < 0.005
    parts, rest = comparison.explanation.parts["weighted"], comparison.explanation.rest["weighted"]
    assert max(parts, key=lambda cause: abs(parts[cause])) == effect
    assert abs(rest) < 0.2 * abs(parts[effect])

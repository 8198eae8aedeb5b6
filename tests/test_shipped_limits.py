"""The shipped limits of a damper, by simulated recordings of the shipped test."""

from pathlib import Path

import pytest
from in_process import run_mrd

from mrd_base.json_file import read_json
from mrd_characterisation.acceptance_file import SCHEMA

ROOT = Path(__file__).resolve().parents[1]
LIMITS, SWEEP = ROOT / "config/acceptance/rd_8040_1.yaml", ROOT / "config/experiments/acceptance/04_speed_sweep.yaml"


@pytest.mark.parametrize(("effect", "outcome"), [([], "pass"), (["--effect", "joint_play.play=0.0006"], "fail")])
def test_play_in_a_joint_fails_by_the_width_between_the_branches(tmp_path: Path, effect: list[str], outcome: str) -> None:
    """It changes the forces little, because what one branch of a cycle loses the other has."""

    def mrd(*arguments: object) -> None:
        ended = run_mrd(*arguments)
        assert ended.returncode in (0, 1), ended.stderr  # 1: not passed, because only the sweep is recorded here

    recorded, plant = tmp_path / "SN-1", ROOT / "config/plant.yaml"
    mrd("simulate", SWEEP, "--plant", plant, "--noise", "--seed", 3, *effect, "--output", recorded)
    mrd("accept", *sorted(recorded.glob("*.csv")), "--reference", LIMITS, "--output", tmp_path)
    checks = read_json(tmp_path / "acceptance.json", "mrd_characterisation", "acceptance", SCHEMA)["checks"]
    outcomes = {check["quantity"]: check["outcome"] for check in checks if check["outcome"] != "not_measured"}
    assert outcomes["hysteresis_width"] == outcome
    assert outcomes["energy_per_cycle"] == "pass"

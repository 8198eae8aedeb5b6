"""Damper tests on the whole simulated bench: a short acceptance test, a warm-up that ends early, an endurance test."""

import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from whole_bench import BENCH, PLANT, without_progress

from mrd_runs import read_run
from mrd_trajectory.settings import read_settings
from mrd_trajectory.steps import read_experiments

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(400)]

SHORT_ACCEPTANCE: dict[str, dict[str, Any]] = {
    "1_warm_up": {"test": "warm_up", "cycles": 15, "until": {"settled_percent": 3}},
    "2_gas_force": {"test": "gas_force", "speeds_mm_per_s": [40, 20], "amplitude_mm": 10, "cycles": 2},
    "3_seal_drag": {"test": "seal_drag", "speeds_mm_per_s": [10, 5], "amplitude_mm": 2, "cycles": 2},
    "4_speed_sweep": {"test": "speed_sweep", "speeds_mm_per_s": [100], "cycle_s": 0.8, "cycles": 2},
    "5_response_time": {"test": "response_time", "currents_mA": [200], "cycles": 2},
}


def write_tests(folder: Path, tests: dict[str, dict[str, Any]]) -> Path:
    folder.mkdir()
    for name, test in tests.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump({"name": name, **test}))
    return folder


def record(steps: Path, output: Path, *options: object) -> subprocess.CompletedProcess[str]:
    """Run the tool `bench` with damper tests on the simulated bench."""
    command = ["ros2", "run", "mrd_bench_driver", "bench", steps, "--bench", BENCH, "--simulated", "--output", output]
    return subprocess.run([*map(str, command), *map(str, options)], capture_output=True, text=True, timeout=380)


def test_an_acceptance_test_is_recorded_and_its_warm_up_ends_once_the_force_has_settled(tmp_path: Path) -> None:
    steps, output = write_tests(tmp_path / "short", SHORT_ACCEPTANCE), tmp_path / "recorded"
    ended = record(steps, output)
    assert ended.returncode == 0, ended.stderr
    assert not without_progress(ended.stderr)
    first, *lines = ended.stdout.splitlines()
    place = next(number for number, line in enumerate(lines) if " recordings of damper tests: " in line)
    lines, (count, sentence, *reports) = lines[:place], lines[place:]
    bench = read_settings(BENCH)
    experiments = [one for file in sorted(steps.glob("*.yaml")) for one in read_experiments(file, bench)]
    assert first.startswith(f"short: {len(experiments)} experiments, ")
    assert [Path(line.partition(": ")[0]).name for line in lines] == [one.name for one in experiments]
    assert count == f"{len(experiments) - 1} recordings of damper tests: {output}"  # the warm-up is none

    # The reports come by themselves.
    assert sentence.startswith("recorded: ")
    assert {"characterisation.json", "characterisation.html", "sheet.html", "sheet.pdf"} <= {Path(r).name for r in reports}
    assert all(Path(report).is_file() for report in reports)

    warm_up, *others = experiments
    run = read_run(output / warm_up.name)
    told = re.match(r"the peak force settled after (\d+) passes: it changed by ", run.info["ended"])
    assert told is not None, run.info["ended"]
    passes = 1 + int(told[1])  # the pass that ran when the samples had shown it goes to its end
    assert 4 <= passes < warm_up.repeats
    moving = np.abs(run.velocity) > 0.2 * warm_up.rod.amplitude * 2 * np.pi * warm_up.rod.frequency
    time = run.time[moving][-1] - run.time[moving][0]
    assert time == pytest.approx(passes * warm_up.duration, abs=0.8 * warm_up.duration)
    # It has come to rest at mid-stroke by the normal way, without current, and the bag holds the rest.
    at_rest = run.time > run.time[-1] - 0.3
    assert np.abs(run.position[at_rest]).max() < 1e-3
    assert np.abs(run.current[at_rest]).max() < 0.05
    assert all("ended" not in read_run(output / one.name).info for one in others)

    # What ended early is complete: nothing of it is missing.
    again = record(steps, output, "--resume")
    assert again.stdout.splitlines()[:2] == [f"{output}: nothing is missing", count]


@pytest.mark.slow
def test_an_endurance_test_ends_at_its_limit_and_can_be_completed(tmp_path: Path) -> None:
    plant = yaml.safe_load(PLANT.read_text())
    plant["/**/plant"]["ros__parameters"]["damper"]["effects"] = "settling: {excess: 0.4, travel: 0.3}"
    (tmp_path / "plant.yaml").write_text(yaml.safe_dump(plant))
    wear = {
        "test": "endurance", "cycles": 12, "every": 4, "characterisation_cycles": 2, "stop_when": {"peak_force_percent": 3},
    }  # fmt: skip
    steps, output = write_tests(tmp_path / "wear", {"wear": wear}), tmp_path / "recorded"
    ended = record(steps / "wear.yaml", output, "--plant", tmp_path / "plant.yaml")
    assert ended.returncode == 0, ended.stderr
    recorded = sorted(bag.name for bag in output.glob("wear_*"))
    assert recorded == ["wear_000_characterisation", "wear_001_characterisation", "wear_001_cycles"]
    ending = "wear_001_characterisation: the peak force has changed by "
    assert f"the set ends here: {ending}" in ended.stdout
    # To resume it changes nothing: the recordings tell that it has ended.
    again = record(steps / "wear.yaml", output, "--resume")
    assert f"the set has ended: {ending}" in again.stdout
    assert f"{output}: nothing is missing" in again.stdout
    # With a wider limit, the next block is what is missing, and is recorded.
    (steps / "wear.yaml").write_text(
        yaml.safe_dump({"name": "wear", **wear, "cycles": 8, "stop_when": {"peak_force_percent": 90}})
    )
    more = record(steps / "wear.yaml", output, "--resume", "--plant", tmp_path / "plant.yaml")
    assert more.returncode == 0, more.stderr
    assert "the set ends here" not in more.stdout
    assert (output / "wear_002_characterisation").exists()

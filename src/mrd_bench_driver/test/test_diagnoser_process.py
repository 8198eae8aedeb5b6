"""The process of the diagnoser among those of the bench."""

from pathlib import Path

import pytest

from mrd_bench_driver.processes import bench_processes


@pytest.mark.parametrize("asked", [{"page": True}, {"diagnoser": True}])
def test_the_diagnoser_has_the_parameters_of_the_bench(tmp_path: Path, asked: dict[str, bool]) -> None:
    bench = tmp_path / "bench.yaml"
    specs = {spec.executable: spec for spec in bench_processes(bench, tmp_path / "plant.yaml", tmp_path / "motor", **asked)}
    assert specs["diagnoser"].files == (bench,)

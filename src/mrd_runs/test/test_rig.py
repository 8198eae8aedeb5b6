"""What the files of a rig do not tell, saved once."""

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_runs
from mrd_runs.importing.rig import read_rig


def write(folder, text):
    file = folder / "rig.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_files_are_read_with_what_the_rig_says(tmp_path):
    time = np.arange(500) / 250.0
    for name, size in (("a.txt", 1.0), ("b.txt", 0.5)):
        table = np.stack([time, 9 * size * np.sin(6 * time), -np.cos(6 * time)], axis=1)
        np.savetxt(tmp_path / name, table, delimiter=";", header="Zeit;Kanal 1;Kanal 2", comments="")
    rig = write(
        tmp_path,
        "map: {time: Zeit, position: Kanal 1, force: Kanal 2}\n"
        "units: {time: s, position: mm, force: 200 N}\nflip: [force]\ncurrent: 0.4\n",
    )
    runs = read_runs(tmp_path / "*.txt", rig=rig)
    assert [run.name for run in runs] == ["a", "b"]
    np.testing.assert_allclose(runs[1].position, 4.5e-3 * np.sin(6 * time), atol=1e-9)
    np.testing.assert_allclose(runs[0].force, 200.0 * np.cos(6 * time), atol=1e-9)
    assert (runs[0].current == 0.4).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("maps: {}", "unknown entry maps; did you mean map?"),
        ("map: [1]", "map is [1], expected {QUANTITY: TEXT}"),
        ("map: {torque: a}", "map: unknown quantity torque"),
        ("flip: force", "flip is 'force', expected a list of quantities"),
        ("current: a", "current is 'a', expected a number"),
        ("rate: 0", "rig.yaml: rate is 0, expected a sample rate in Hz"),
        ("rate: .nan", "rig.yaml: rate is nan, expected a sample rate in Hz"),
        ("current: .inf", "rig.yaml: current is inf, expected a finite number of A"),
        ("flip: [force, force]", "rig.yaml: flip is force force, expected each quantity once"),
        ("units: {force: 0 N}", "rig.yaml: units: one unit of the force is 0 N, expected another number than 0"),
        ("units: {force: V}", "rig.yaml: units: the force is in V, expected N"),
        ("", "is empty, expected a mapping"),
    ],
)
def test_a_wrong_entry_is_one_line(tmp_path, text, message):
    with pytest.raises(InputError) as error:
        read_rig(write(tmp_path, text))
    assert message in str(error.value)
    assert "\n" not in str(error.value)

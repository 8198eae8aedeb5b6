"""The catalogue of effects shown, written, and added to by a user."""

import sys
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_sim.cli import effects as tool
from mrd_sim.cli import simulate as simulate_tool
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS, load_effects
from mrd_sim.effects_page import COMMAND, EXAMPLE, page
from mrd_sim.models import find_model
from mrd_sim.own import own_catalogue

SERIES = """
from numba import njit
from mrd_sim.effects import Effect
from mrd_sim.parameter import Parameter

@njit
def elongation(p, before, dt, force, x):
    return p[0] * force

EFFECT = Effect(
    id="rubber", title="Rubber mount", stage="structure", equation="e = s F", source="mine",
    parameters=(Parameter("softness", "m/N", 0.0, 0.0, 1e-5, "softness"),), typical={"softness": 1e-6},
    signature="-", confused_with=("series_compliance",), separated_by="-", elongation=elongation,
)
"""


@pytest.fixture(autouse=True)
def catalogue():
    """As it was before, whatever a test loads."""
    with own_catalogue():
        yield


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["effects", *map(str, arguments)])
    monkeypatch.setenv("COLUMNS", "250")
    tool.work()


def test_docs_are_those_of_the_catalogue():
    written = Path(__file__).resolve().parents[3] / "docs" / "effects.md"
    assert written.read_text(encoding="utf-8") == page(), f"the catalogue has changed; write the page anew: {COMMAND}"


def test_tool_shows_the_catalogue_and_each_effect(monkeypatch, capsys):
    run(monkeypatch)
    shown = capsys.readouterr().out
    assert all(f" {name} " in shown for name in EFFECTS)
    for effect in EFFECTS.values():
        run(monkeypatch, effect.id)
        shown = capsys.readouterr().out
        assert all(f"{effect.id}.{parameter.name}" in shown for parameter in effect.parameters)
        assert effect.separated_by in shown
    run(monkeypatch, "--markdown")
    assert capsys.readouterr().out == page()
    with pytest.raises(InputError, match="unknown effect ghost"):
        run(monkeypatch, "ghost")


def test_the_example_of_the_docs_is_an_effect_of_ones_own(tmp_path, monkeypatch, capsys):
    (tmp_path / "magnet.py").write_text(EXAMPLE, encoding="utf-8")
    (tmp_path / "helper.py").write_text("raise RuntimeError('no effect, must not be imported')", encoding="utf-8")
    run(monkeypatch, "magnet", "--effects-folder", tmp_path)
    assert "magnet.holding" in capsys.readouterr().out
    time = np.arange(1000) / 500
    motion = (0.01 * np.sin(6 * time), 0.06 * np.cos(6 * time), -0.36 * np.sin(6 * time), np.zeros(1000))
    force = Damper("bouc_wen").advance(0.002, *motion)
    near = motion[0] / 2e-3
    held = Damper("bouc_wen", effects={"magnet": {"holding": 30.0}}).advance(0.002, *motion)
    assert held - force == pytest.approx(30.0 * near * np.exp(-(near**2)))


def test_loaded_again_an_effect_takes_the_place_of_the_one_before(tmp_path):
    file = tmp_path / "rubber.py"
    file.write_text(SERIES, encoding="utf-8")
    (first,) = load_effects(tmp_path)
    file.write_text(SERIES.replace("Rubber mount", "Harder rubber"), encoding="utf-8")
    (second,) = load_effects(tmp_path)
    assert (first.title, second.title, EFFECTS["rubber"].title) == ("Rubber mount", "Harder rubber", "Harder rubber")
    model = find_model("bouc_wen", effects=["rubber"])
    same = find_model("bouc_wen", effects=["series_compliance"])
    time = np.arange(500) / 500
    motion = (0.005 * np.sin(9 * time), 0.045 * np.cos(9 * time), -0.405 * np.sin(9 * time), np.zeros(500))
    mine = Damper("bouc_wen", effects={"rubber": {"softness": 1e-6}}).advance(0.002, *motion)
    shipped = Damper("bouc_wen", effects={"series_compliance": {"compliance": 1e-6}}).advance(0.002, *motion)
    assert np.array_equal(mine, shipped)
    assert len(model.names) == len(same.names)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("@njit", "@njit(", r"mine\.py: cannot be imported \(SyntaxError: "),
        ("from numba", "from nowhere", r"mine\.py: cannot be imported \(ModuleNotFoundError: No module named 'nowhere'\)"),
        ("EFFECT = Effect(", "EFFECT = dict(", r"mine\.py: EFFECT is dict, expected mrd_sim\.effects\.Effect"),
        ('id="rubber"', 'id="Rubber mount"', r"mine\.py: id is 'Rubber mount', expected lower-case"),
        ('id="rubber"', 'id="backlash"', r"mine\.py: there is an effect backlash already"),
        ('"structure"', '"concrete"', r"mine\.py: stage is 'concrete', expected one of drive, "),
        ('title="', 'needs=("steps",), title="', r"mine\.py: needs holds 'steps', expected any of changing current, "),
        ('title="', 'imitated_by=("lag",), title="', r"mine\.py: imitated_by holds 'lag', expected any of timing, clocks, "),
        ('title="', 'shows=("reversals",), title="', r"mine\.py: shows holds 'reversals', expected any of reversal, "),
        ("elongation=elongation", "kernel=None", r"mine\.py: has [02] of kernel, elongation and coefficients, expected one"),
        ('title="', 'phrase="{ghost} of give", title="', r"mine\.py: phrase '{ghost} of give' names ghost, expected"),
        ('title="', 'phrase="{softness of give", title="', r"mine\.py: phrase '{softness of give' cannot be filled in"),
        ("0.0, 0.0, 1e-5", "0.0, 1e-6, 1e-5", r"mine\.py: softness has default 0, typical 1e-06, expected both within"),
        ("@njit", "", r"mine\.py: elongation is not compiled, expected numba's @njit"),
        ("return p[0] * force", "return force", r"mine\.py: the effect acts at its parameters' defaults"),
        ("return p[0] * force", "return ghost * force", r"mine\.py: the effect fails \(TypingError: .*ghost"),
    ],
)
def test_what_is_wrong_with_an_effect_is_one_line(tmp_path, old, new, words):
    assert old in SERIES
    (tmp_path / "mine.py").write_text(SERIES.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=words) as refused:
        load_effects(tmp_path)
    assert "\n" not in str(refused.value)
    assert "rubber" not in EFFECTS


def test_a_folder_without_effects_is_refused(tmp_path):
    with pytest.raises(InputError, match="no effects, expected"):
        load_effects(tmp_path)
    with pytest.raises(InputError, match="nowhere: cannot be read"):
        load_effects(tmp_path / "nowhere")


def test_two_files_with_one_id_are_refused(tmp_path):
    for name in ("one", "two"):
        (tmp_path / f"{name}.py").write_text(SERIES, encoding="utf-8")
    with pytest.raises(InputError, match=r"two\.py: there is an effect rubber already"):
        load_effects(tmp_path)


def test_simulate_takes_effects_of_ones_own(tmp_path, monkeypatch):
    (tmp_path / "rubber.py").write_text(SERIES, encoding="utf-8")
    experiment = tmp_path / "short.yaml"
    experiment.write_text(
        "name: short\nduration_s: 1.0\nrate_hz: 500.0\n"
        "rod: {waveform: sine, amplitude_mm: 5.0, frequency_hz: 2.0}\ncoil: {waveform: constant, level_mA: 200.0}\n"
    )
    forces = []
    for i, more in enumerate(([], ["--effects-folder", tmp_path, "--effect", "rubber.softness=1e-6"])):
        output = tmp_path / f"{i}.csv"
        arguments = [experiment, "--model", "bouc_wen", *more, "--output", output]
        monkeypatch.setattr(sys, "argv", ["simulate", *map(str, arguments)])
        simulate_tool.work()
        forces.append(np.loadtxt(output, delimiter=",", skiprows=1)[:, 3])
    assert np.max(np.abs(forces[1] - forces[0])) > 1.0

"""Damper models of one's own."""

import sys

import numpy as np
import pytest

from mrd_base import InputError
from mrd_sim.cli import models as tool
from mrd_sim.models import MODELS, find_model, load_models
from mrd_sim.models.loading import missing_property
from mrd_sim.models_page import EXAMPLE
from mrd_sim.own import model_arguments, own_catalogue
from mrd_sim.path import make_path
from mrd_sim.plant import DamperConfig


@pytest.fixture
def folder(tmp_path):
    """A folder with the example of the docs; the catalogue is afterwards as before."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "mine.py").write_text(EXAMPLE)
    with own_catalogue():
        yield tmp_path / "own"


def test_the_example_becomes_a_model_of_the_catalogue(folder, monkeypatch, capsys):
    (model,) = load_models(folder)
    assert find_model("asymmetric_bingham", "tanh").laws["friction_out"] == "tanh"
    time = np.linspace(0, 1, 1001)
    w = 2 * np.pi
    path = make_path(time, np.sin(w * time), w * np.cos(w * time), -(w**2) * np.sin(w * time), np.zeros(len(time)))
    force = model.force(model.vector({"friction_out": 100.0, "friction_in": 40.0, "viscous": 10.0, "coil_lag": 0.0}), path)
    assert force[0] == pytest.approx(100.0 + 10.0 * w)
    assert force[500] == pytest.approx(-40.0 - 10.0 * w)
    monkeypatch.setattr(sys, "argv", ["models", "--models-folder", str(folder), "asymmetric_bingham"])
    tool.work()
    assert "friction_out" in capsys.readouterr().out


def test_a_plant_has_a_model_of_ones_own(folder):
    damper = DamperConfig("asymmetric_bingham", "{friction_out: 90.0}", models_folder=str(folder)).build()
    assert damper.theta[damper.model.names.index("friction_out")] == 90.0


def test_a_piece_of_work_leaves_the_catalogue_as_it_was(folder):
    with own_catalogue(str(folder)):
        assert model_arguments("asymmetric_bingham") == f"--model asymmetric_bingham --models-folder {folder}"
    assert "asymmetric_bingham" not in MODELS
    assert model_arguments("bingham", MODELS["bingham"].laws) == "--model bingham"
    with pytest.raises(InputError, match="nowhere"), own_catalogue("nowhere"):
        pytest.fail("the folder is not there")


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_catalogue_has_what_is_expected_of_ones_own(model):
    assert missing_property(model) == ""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    odd=False,\n", "", "turning the motion round does not turn the force round; write odd=False if that is meant"),
        (
            "force[k] = friction",
            "force[k] = -friction",
            "a closed cycle yields energy at the defaults; write dissipative=False",
        ),
        ("+ c.viscous * v[k]", "+ c.viscous / (v[k] - v[k])", "the model fails (ZeroDivisionError: division by zero)"),
        ("@njit(cache=True, nogil=True)\n", "", "_force is not compiled, expected numba's @njit"),
        ("1000.0, 0.0, 1e4", "1000.0, 0.0, 1e2", "viscous has the default 1000, expected one within its bounds, 0 to 100"),
        ("asymmetric_bingham", "bingham", "there is a model bingham already"),
        ("asymmetric_bingham", "My model", "id is 'My model', expected lower-case"),
        ("MODEL = DamperModel(", "MODEL = dict(", "MODEL is dict, expected mrd_sim.models.DamperModel"),
        ("MODEL = DamperModel(", "M = DamperModel(", "no damper models, expected"),
        ("from numba import njit", "import nothing_of_this_name", "cannot be imported"),
    ],
)
def test_one_line_says_what_is_wrong(folder, old, new, message):
    assert old in EXAMPLE
    (folder / "mine.py").write_text(EXAMPLE.replace(old, new))
    with pytest.raises(InputError) as error:
        load_models(folder)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert str(folder) in str(error.value)

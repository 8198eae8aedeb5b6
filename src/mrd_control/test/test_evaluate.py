"""The tool: what it refuses, what it writes, and that its search finds better gains."""

import json
import sys
from itertools import combinations, product
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from distributed import LocalCluster

from mrd_base import InputError
from mrd_base.json_file import read_schema
from mrd_control.cli.evaluate import _parser, _read_dampers, main
from mrd_control.evaluation import Candidate, Conditions, evaluate, optimise_gains, parse_candidate
from mrd_control.excitations import GroundMotion, Road
from mrd_control.figures import trade_off
from mrd_control.laws import LAWS
from mrd_control.report import columns, rows, sentence, write_evaluation
from mrd_control.systems import QuarterCar, ShearBuilding
from mrd_sim.damper import Damper
from mrd_sim.plant import read_damper

PLANT = Path(__file__).resolve().parents[3] / "config/plant.yaml"
SHORT = ["--duration", "6"]


@pytest.fixture
def tool(monkeypatch, capsys, tmp_path):
    """Run the tool; return its exit status, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["evaluate", *map(str, arguments), "--output", str(tmp_path / "out")])
        monkeypatch.chdir(tmp_path)
        try:
            main()
            status = 0
        except SystemExit as left:
            status = left.code
        return status, *capsys.readouterr()

    return run


def test_all_laws_are_compared_on_a_page_and_in_a_file(tool, tmp_path):
    status, out, err = tool(*SHORT, "--roads", "B,C")
    assert status == 0, err
    content = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    jsonschema.validate(content, read_schema("mrd_control", "evaluation"))
    assert {entry["law"] for entry in content["laws"]} == set(LAWS)
    assert len(content["laws"]) == 2 * len(LAWS)
    assert len(content["passive"]) == 2 * 9
    rough = {entry["law"]: entry["ride"]["acceleration"] for entry in content["laws"] if "class C" in entry["excitation"]}
    smooth = {entry["law"]: entry["ride"]["acceleration"] for entry in content["laws"] if "class B" in entry["excitation"]}
    assert all(1.4 * smooth[law] < rough[law] < 2.6 * smooth[law] for law in LAWS)
    page = (tmp_path / "out" / "evaluation.html").read_text()
    # Pictures come before tables, and the page needs no network.
    assert page.index("<svg") < page.index("<table")
    assert 'src="http' not in page
    for law in LAWS.values():
        assert law.id in page
    assert "most comfortable law" in out


def test_gains_are_searched_on_every_road_with_every_damper(tool, tmp_path):
    """Page, file and output say for which road and damper each front holds."""
    for name, viscous in (("soft", 500), ("stiff", 2000)):
        plant = f"plant:\n  ros__parameters:\n    damper:\n      parameters: '{{viscous: {viscous}}}'\n"
        (tmp_path / f"{name}.yaml").write_text(plant)
    dampers = ("--damper", "soft.yaml", "--damper", "stiff.yaml")
    search = ("--pareto", "skyhook", "groundhook", "--population", 4, "--generations", 2)
    status, out, err = tool(*SHORT, "--roads", "A,B", *dampers, "--laws", "skyhook", *search)
    assert status == 0, err
    content = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    jsonschema.validate(content, read_schema("mrd_control", "evaluation"))
    roads = ("class A, 20 m/s", "class B, 20 m/s")
    places = list(product(("skyhook", "groundhook"), ("soft", "stiff"), roads))
    assert [(front["law"], front["damper"], front["excitation"]) for front in content["fronts"]] == places
    points = [front["points"] for front in content["fronts"]]
    assert all(one != other for one, other in combinations(points, 2))
    page = (tmp_path / "out" / "evaluation.html").read_text()
    _, _, section = page.partition("<h2>Pareto fronts of the gains</h2>")
    for law, damper, road in places:
        assert f"<td>{law}</td><td>{road}</td><td>{damper}</td>" in section
        assert f"{road}, {damper}" in section
    assert out.count("skyhook_viscous ") == len(places) // 2


def test_the_same_seed_gives_the_same_file_and_another_seed_another_road(tool, tmp_path):
    contents = []
    for seed in (1, 1, 2):
        assert tool(*SHORT, "--roads", "A", "--laws", "skyhook", "--seed", seed)[0] == 0
        contents.append((tmp_path / "out" / "evaluation.json").read_text())
    assert contents[0] == contents[1] != contents[2]


def test_a_hybrid_test_states_margin_and_tracking(tool, tmp_path):
    (tmp_path / "car.yaml").write_text("system: quarter_car\nunsprung_mass_kg: 120\n")
    arguments = (*SHORT, "--system", "car.yaml", "--roads", "A", "--laws", "skyhook_on_off", "--most-current", 0.4)
    status, out, err = tool(*arguments, "--delay", 3, "--predictor", "polynomial")
    assert status == 0, err
    content = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert content["margins"]["bench"]["delay_s"] > 0.003
    assert content["system"]["unsprung_mass_kg"] == 120
    assert abs(content["laws"][0]["tracking"]["delay"]) < 1e-3
    assert "<code>car.yaml</code>" in (tmp_path / "out" / "evaluation.html").read_text().partition("<footer>")[2]
    assert "NRMS" in out
    status, _, err = tool(*arguments, "--delay", 40)
    assert status == 2
    assert "the hybrid loop is unstable: at " in err
    assert "stable would be a total delay below" in err


OTHER_SCHEMA = json.dumps({"schema": "mrd-fit/1", "model": "bingham"})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--laws", "skyhok"], "unknown law skyhok; did you mean skyhook"),
        (["--laws", "skyhook:gain=3"], "law skyhook: unknown parameter gain"),
        (["--laws", "skyhook:skyhook_viscous=much"], "skyhook_viscous=much is not a parameter with its value"),
        (["--laws", "skyhook:skyhook_viscous=-5"], "skyhook_viscous is -5 N s/m, expected 1 to 1e+06"),
        (["--pareto", "skyhok"], "unknown law skyhok"),
        (["--system", "negative.yaml"], "negative.yaml: sprung_mass_kg: found -320, expected 1 to 100000"),
        (["--system", "train"], "--system train: expected one of quarter_car"),
        (["--excitation", "short.yaml"], "short.csv: is 2 s long, expected at least 6 s"),
        (["--model", "linear_viscous", "--parameters", "{viscous_per_A: 0}"], "model linear_viscous has no inverse"),
        (["--model", "linear_vicous"], "unknown model linear_vicous"),
        (["--damper", "other.json"], "other.json: its schema is mrd-fit/1, expected a fit.json of mrd-fit/"),
        (["--damper", "none.json"], "none.json: cannot be read"),
        (["--roads", "B,Z"], "--roads: unknown class Z"),
        (["--roads", ""], "--roads is empty"),
        (["--speed", "0"], "--speed is 0 m/s"),
        (["--speed", "nan"], "--speed is nan m/s"),
        (["--duration", "1"], "--duration is 1, expected 5 to 3600"),
        (["--rate", "nan"], "--rate is nan"),
        (["--lag", "3"], "give its --delay"),
        (["--seed", "-1"], "--seed is -1"),
        (["--parameters", "{viscous: 3}"], "--parameters are those of a --model"),
    ],
)
def test_bad_input_is_refused_in_one_line_with_status_2(tool, tmp_path, arguments, message):
    (tmp_path / "negative.yaml").write_text("system: quarter_car\nsprung_mass_kg: -320\n")
    (tmp_path / "short.yaml").write_text("excitation: recorded_profile\nfile: short.csv\n")
    (tmp_path / "short.csv").write_text("time_s,position_m\n0,0\n1,0.01\n2,0\n")
    (tmp_path / "other.json").write_text(OTHER_SCHEMA)
    status, _, err = tool(*SHORT, *arguments)
    assert status == 2
    assert message in err
    # A machine slowed down by other work has time to print its progress, too.
    assert len([line for line in err.splitlines() if not line.startswith("evaluating: ")]) == 1


def test_the_search_finds_gains_that_beat_the_default_and_the_constant_currents():
    """The system is heavy enough for the damper. Each end of the front is better at one thing than the default gains."""
    system, damper = QuarterCar(lever_ratio=0.4), Damper("bouc_wen", {"viscous": 900.0, "offset": 0.0})
    road, conditions = Road("C", 20.0), Conditions(duration=10.0)
    evaluation = evaluate(system, {"bench": damper}, [Candidate("skyhook", "skyhook")], {"road": road}, conditions)
    front = optimise_gains(
        system, ("bench", damper), LAWS["hybrid"], ("road", road), conditions, population=12, generations=5, seed=1
    )
    assert (np.diff(front.objectives[:, 0]) >= 0).all()
    assert (np.diff(front.objectives[:, 1]) <= 0).all()
    passive = evaluation.best_passive("bench", "road").ride
    assert front.objectives[0, 0] < passive.weighted
    assert front.objectives[-1, 1] < passive.contact
    names = set(front.names)
    assert names == {"skyhook_viscous", "groundhook_viscous", "share"}


def test_many_roads_stand_side_by_side():
    roads = {f"{speed} m/s": Road("A", float(speed)) for speed in range(10, 25)}
    evaluation = evaluate(
        QuarterCar(), {"bench": Damper("bingham")}, [parse_candidate("skyhook")], roads, Conditions(duration=5.0)
    )
    assert len(trade_off(evaluation).layout.annotations) == len(roads)


def test_several_dampers_stand_in_one_table_and_a_building_has_drifts():
    dampers = {"weak": Damper("bingham", {"yield_force": 30.0}), "strong": Damper("bingham", {"yield_force": 150.0})}
    candidates = [parse_candidate("skyhook_on_off"), parse_candidate("clipped_lqr:high_current=0.5")]
    evaluation = evaluate(ShearBuilding(), dampers, candidates, {"smooth": Road("A", 0.5)}, Conditions(duration=6.0))
    table = rows(evaluation)
    assert len(table) == 2 * (1 + 2)
    assert all(len(row) == len(columns(evaluation)) for row in table)
    assert "drift, mm" in columns(evaluation)
    assert sentence(evaluation).count("most comfortable") == 2


@pytest.mark.timeout(300)
def test_a_cluster_gives_the_same_metrics():
    arguments = (
        QuarterCar(lever_ratio=0.4),
        {
            "fitted": Damper("bouc_wen", {"viscous": 900.0}),
            "lagging": Damper("bouc_wen", effects={"coil_lag": {"lag": 0.01}}),
        },
        [parse_candidate("skyhook"), parse_candidate("clipped_lqg")],
        {"rough": Road("C"), "quake": GroundMotion()},
        Conditions(duration=6.0),
    )
    done = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        found = evaluate(*arguments, scheduler=cluster.scheduler_address, done=done.append)
    expected = evaluate(*arguments)
    assert [entry.ride for entry in found.entries] == [entry.ride for entry in expected.entries]
    assert [entry.ride for entry in found.passive] == [entry.ride for entry in expected.passive]
    assert max(done) == 2 * 2 * (2 + 9) - 1


def test_a_loop_that_diverges_is_said_to_diverge(tmp_path):
    """On a road as rough as this the wheel leaves every bound; the page says so, and shows no figure of nothing."""
    damper = Damper("linear_viscous", {"viscous": 1500.0, "viscous_per_A": 0.0})
    rough = Conditions(duration=6.0)
    evaluation = evaluate(
        QuarterCar(), {"soft": damper}, [Candidate("none", "constant_current")], {"H": Road("H", 120.0)}, rough
    )
    assert evaluation.entries[0].ride is None
    assert rows(evaluation)[-1][3] == "diverged"
    assert "every law diverged" in sentence(evaluation)
    assert "diverged" in write_evaluation(evaluation, [], tmp_path).read_text()


def test_the_damper_called_bench_is_that_of_the_shipped_plant():
    (damper,) = _read_dampers(_parser().parse_args(["--output", "out"])).values()
    shipped = read_damper(PLANT).build()
    assert damper.model == shipped.model
    np.testing.assert_array_equal(damper.theta, shipped.theta)


def test_an_unknown_predictor_is_refused_before_any_run(tool):
    status, _, err = tool(*SHORT, "--delay", 1, "--predictor", "magic")
    assert status == 2
    assert "invalid choice: 'magic'" in err


def test_a_candidate_is_read_with_its_gains():
    assert parse_candidate("hybrid:share=0.4,skyhook_viscous=2e3").gains == {"share": 0.4, "skyhook_viscous": 2000.0}
    with pytest.raises(InputError, match="unknown law"):
        parse_candidate(":share=0.4")

"""Writes tables of docs/control.md.

python docs/tables/control.py                        # those with the damper of the simulated bench (ten seconds)
python docs/tables/control.py runs/utfsm/fit.json    # and those with the damper that the page identifies (a minute)
python docs/tables/control.py --hybrid-test runs/hybrid/hybrid_test.json    # and that of a hybrid test on the bench

With --check it writes nothing, and fails where the page is not up to date.
"""

import argparse
import json
import sys
import textwrap
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path

import numpy as np
from benchmark_problem import benchmark_problem
from sections import page_with, table

from mrd_base import InputError
from mrd_control.controller import Actuator
from mrd_control.evaluation import Candidate, Conditions, Entry, Evaluation, comfort, evaluate, measure_case, optimise_gains
from mrd_control.excitations import GroundMotion, Road
from mrd_control.laws import LAWS, find_law
from mrd_control.prediction import PREDICTORS
from mrd_control.stability import check_stability, stability_margin
from mrd_control.systems import ShearBuilding, System, read_system
from mrd_control.tracking import Tracking
from mrd_identification import load_damper
from mrd_sim.damper import Damper
from mrd_sim.plant import DamperConfig

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "control.md"
CAR = read_system(ROOT / "config" / "control" / "quarter_car.yaml")
ROADS = {name: Road(name, 20.0, seed=1) for name in "BC"}
ACTIVE = [Candidate(name, name) for name in LAWS if name != "constant_current"]
EXPECTED = {
    "skyhook_on_off": "calms the body, but switching adds acceleration (an open benchmark: 2.17 against 1.66 m/s² passive)",
    "skyhook": "rms acceleration 10 to 30 % below a good passive damper, more wheel hop",
    "groundhook": "less tyre load at the cost of comfort",
    "hybrid": "between the two",
    "acceleration_driven": "good above the body's frequency, poor at it",
    "mixed_skyhook_add": "as the better of the two at each frequency",
    "clipped_lqr": "near the best compromise of its weights",
    "clipped_lqg": "as LQR, from measured signals",
    "force_tracking": "as skyhook; the feedback only corrects the model",
}
"""The literature expects this of each law."""
ACTUATORS = {
    "2 ms dead time": Actuator(0.002),
    "8 ms dead time": Actuator(0.008),
    "3 ms dead time, 5 ms lag": Actuator(0.003, 0.005),
}
MOST_CURRENT = 0.4
"""A, of the loops with an actuator."""


def change(value: float, reference: float, digits: int = 0) -> str:
    """Return a change in per cent, with the sign of typography."""
    return f"{100 * (value / reference - 1):+.{digits}f} %".replace("-", "−")


def laws(damper: Damper) -> str:
    """Return all laws with their default gains on both roads, beside the best constant current."""
    found = evaluate(CAR, {"": damper}, ACTIVE, ROADS)
    best = {road: found.best_passive("", road) for road in ROADS}
    titles = ["law"]
    cells = ["best constant current"]
    for road, entry in best.items():
        titles += [f"{road}: a W_k, m/s²", "W_k", "a", "tyre"]
        cells += [f"{entry.ride.weighted:.3f} ({entry.candidate.label})", "", "", ""]
    rows = [[*cells, ""]]
    for law in (candidate.law for candidate in ACTIVE):
        cells = [f"`{law}`"]
        for road, entry in best.items():
            ride, passive = entry_of(found, law, road).ride, entry.ride
            cells += [
                f"{ride.weighted:.3f}",
                change(ride.weighted, passive.weighted, 1),
                change(ride.acceleration, passive.acceleration),
                change(ride.contact, passive.contact),
            ]
        rows.append([*cells, EXPECTED[law]])
    return table([*titles, "what the literature expects"], rows)


def entry_of(found: Evaluation, law: str, excitation: str) -> Entry:
    """Return the run of a law on a road."""
    return next(entry for entry in found.entries if (entry.candidate.label, entry.excitation) == (law, excitation))


def lever() -> str:
    """Return the same without the lever, with the damper of the simulated bench: nothing is left to control."""
    found = evaluate(replace(CAR, lever_ratio=1.0), {"": DamperConfig().build()}, ACTIVE, ROADS, Conditions(duration=30.0))
    rows = []
    for road in ROADS:
        best = found.best_passive("", road)
        runs = sorted((entry for entry in found.entries if entry.excitation == road), key=comfort)
        on_off = entry_of(found, "skyhook_on_off", road)
        rows.append(
            [
                road,
                f"{best.ride.weighted:.3f} ({best.candidate.label})",
                f"`{runs[0].candidate.label}` {change(runs[0].ride.weighted, best.ride.weighted, 1)}",
                change(on_off.ride.weighted, best.ride.weighted),
                f"{100 * min(entry.ride.peak_share for entry in runs):.0f} to "
                f"{100 * max(entry.ride.peak_share for entry in runs):.0f} %",
            ]
        )
    titles = ("road", "best constant current, a W_k, m/s²", "best law", "`skyhook_on_off`", "travel over half of the stroke")
    return table(titles, rows)


def gains(damper: Damper) -> str:
    """Return ends and knee of the searched gains of two laws on both roads, and the ends of the constant currents."""
    conditions = Conditions(duration=20.0)
    rows = []
    for road, excitation in ROADS.items():
        passive = [entry.ride for entry in evaluate(CAR, {"": damper}, ACTIVE[:1], {road: excitation}, conditions).passive]
        ends = (min(passive, key=attrgetter(name)) for name in ("weighted", "contact"))
        comfort, hold = (f"{ride.weighted:.3f} / {ride.contact:.0f}" for ride in ends)
        rows.append([road, "constant currents", comfort, "", hold])
        for law in ("skyhook", "hybrid"):
            front = optimise_gains(CAR, ("", damper), find_law(law), (road, excitation), conditions, 16, 8, seed=1)
            reached = [f"{a:.3f} / {tyre:.0f}" for a, tyre in front.objectives]
            rows.append(["", f"`{law}`", reached[0], reached[front.knee], reached[-1]])
    return table(("road", "", "most comfort: a W_k, m/s² / tyre load, N", "knee", "least tyre load"), rows)


def building() -> str:
    """Return two laws in the building of Dyke et al. (1996), with the damper of the simulated bench in its lowest storey."""
    conditions, shaking = Conditions(duration=30.0), GroundMotion()
    laws = [Candidate(name, name) for name in ("clipped_lqr", "force_tracking")]
    found = evaluate(ShearBuilding(), {"": DamperConfig().build()}, laws, {"": shaking}, conditions)
    off = found.passive[0].ride
    rows = [["0 A", f"{1e3 * off.peak_drift:.2f}", ""]]
    for entry in found.entries:
        weighted = change(entry.ride.weighted, off.weighted, 1)
        rows.append([f"`{entry.candidate.law}`", f"{1e3 * entry.ride.peak_drift:.2f}", weighted])
    return table(("law", "largest drift, mm", "a W_k of the top"), rows)


def refusal() -> str:
    """Return how an unstable set-up is refused: the car without lever, with the damper of the simulated bench."""
    car, damper = replace(CAR, lever_ratio=1.0), DamperConfig().build()
    try:
        check_stability(car.linear(), damper, Actuator(0.02), 1000.0, list(Conditions().currents))
    except InputError as error:
        return textwrap.fill(f"error: {error}", 134, initial_indent="    ", subsequent_indent="    ")
    raise SystemExit("the loop of the example is stable")


def delays(damper: Damper) -> str:
    """Return margin and tracking of three actuators with each predictor, with the shipped wheel and a heavy one."""
    currents = list(np.linspace(0.0, MOST_CURRENT, 9))
    rows = []
    for name, actuator in ACTUATORS.items():
        for predictor in PREDICTORS:
            predicted = replace(actuator, predictor=predictor)
            margin = stability_margin(CAR.linear(), damper, predicted, 1000.0, currents).delay
            conditions = Conditions(duration=30.0, most_current=MOST_CURRENT, actuator=predicted)
            followed, heavy = (tracked(system, damper, conditions) for system in (CAR, replace(CAR, unsprung_mass=120.0)))
            refused = ": refused" if margin <= actuator.total_delay else ""
            rows.append(
                [
                    name if predictor == "none" else "",
                    predictor,
                    f"{1e3 * margin:.1f}{refused}",
                    *(("unstable", "", "") if followed is None else shown(followed)),
                    "unstable" if heavy is None else percent(heavy.nrms),
                ]
            )
    return table(("actuator", "predictor", "margin, ms", "delay, ms", "NRMS, %", "peak, %", "NRMS with 120 kg, %"), rows)


def tracked(system: System, damper: Damper, conditions: Conditions) -> Tracking | None:
    """Return the tracking of the rod under skyhook on class B, None where the loop diverges; the check of the stability is
    left out.
    """
    _, followed = measure_case(system.linear(), damper, Candidate("skyhook", "skyhook"), ROADS["B"], conditions)
    return followed


def shown(followed: Tracking) -> tuple[str, str, str]:
    """Return delay in ms, NRMS and peak in %."""
    return milliseconds(followed.delay), percent(followed.nrms), percent(followed.peak)


def percent(share: float) -> str:
    """Return a share in %, a small one with a digit more."""
    return f"{100 * share:.{1 if share >= 0.01 else 2}f}"


def hybrid_test(path: str) -> str:
    """Return how well the rod followed in a hybrid test, and how near the test was to its offline twin."""
    found = json.loads(Path(path).read_text(encoding="utf-8"))
    tracking, timing, ride = found["tracking"], found["timing"], found["ride"]
    apart = max(abs(value / ride["twin"][name] - 1) for name, value in ride["bench"].items() if value)
    rows = [
        ["delay of the rod (J1)", f"{milliseconds(tracking['delay'])} ms", "1 ms"],
        ["NRMS of the tracking (J2)", f"{100 * tracking['nrms']:.1f} %", "3 %"],
        ["peak of the tracking error (J3)", f"{100 * tracking['peak']:.1f} %", ""],
        ["emulated motion against the offline twin", f"{100 * found['twin']['motion_nrms']:.1f} % NRMS", "2 %"],
        ["ride metrics against the twin", f"within {100 * apart:.1f} %", ""],
        ["largest latency", f"{milliseconds(timing['largest_latency_s'])} ms", ""],
        ["jitter, missed deadlines", f"{milliseconds(timing['jitter_s'])} ms, {timing['missed']}", ""],
    ]
    return table(("", "this test", "bound"), rows)


def milliseconds(seconds: float) -> str:
    """Return a time in ms; there is no minus before a zero."""
    return f"{round(1e3 * seconds, 2) + 0.0:.2f}".replace("-", "−")


OF_FIT = {"laws": laws, "gains": gains, "delays": delays}
"""Sections of the page with the identified damper."""
OF_BENCH = {"lever": lever, "building": building, "refusal": refusal, "benchmark problem": benchmark_problem}
"""Sections with that of the simulated bench, and with none."""


def main() -> None:
    """Write or check the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fit", nargs="?", help="the identified damper")
    parser.add_argument("--hybrid-test", metavar="JSON", help="written by the tool hybrid_test")
    parser.add_argument("--check", action="store_true", help="write nothing, fail where the page is not up to date")
    arguments = parser.parse_args()
    sections: dict[str, Callable[[], str]] = dict(OF_BENCH)
    if arguments.fit:
        damper = load_damper(arguments.fit)
        sections |= {name: partial(section, damper) for name, section in OF_FIT.items()}
    if arguments.hybrid_test:
        sections["hybrid test"] = partial(hybrid_test, arguments.hybrid_test)
    old = new = PAGE.read_text(encoding="utf-8")
    for name, section in sections.items():
        new = page_with(new, name, section(), PAGE)
    if arguments.check and new != old:
        sys.exit(f"{PAGE}: is not up to date; run: python docs/tables/control.py, with the same arguments but --check")
    PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()

"""Print the table of the fault campaign: each fault, what is expected of the bench, and what it does (`make faults`).

Every fault is tried on the whole bench: real nodes, topics and serial protocol, simulated motor, damper and converter.
"""

import argparse
import re
import sys
import tempfile
import time
from pathlib import Path

import rclpy  # noqa: F401 - before the domain is claimed nothing of ROS runs

from faults import bench_diagnosis, coil, converter, damper, hybrid_tests, machine, motor, people, processes, serial_line
from faults.campaign import Bench, Fault, Reaction, measure, table
from mrd_base.domain import claim_domain

FAMILIES = (people, serial_line, motor, converter, coil, damper, machine, processes, hybrid_tests, bench_diagnosis)


def run(faults: list[Fault], moments: int, repeat: int, seed: int, folder: Path) -> list[tuple[Fault, list[Reaction]]]:
    """Try every fault several times, those of processes at random moments; return what was measured."""
    ordered = sorted(faults, key=lambda fault: fault.bench)
    todo = [(fault, k) for fault in ordered for k in range(moments if fault.at_random else repeat)]
    measured: dict[Fault, list[Reaction]] = {fault: [] for fault in faults}
    number = 0
    while todo:
        # A bench that is broken is replaced by a new one; a hybrid test needs one with a controller and shorter blocks, a
        # diagnosis on the bench one with a diagnoser.
        number += 1
        needed = todo[0][0].bench
        with Bench(folder / str(number), seed + number, *needed) as bench:
            while todo and todo[0][0].bench == needed:
                fault, _ = todo.pop(0)
                begin = time.monotonic()
                try:
                    reaction = measure(fault, bench, len(todo))
                except Exception as error:  # the campaign goes on with the next fault
                    reaction = Reaction(float("nan"), float("nan"), "", "", (f"{type(error).__name__}: {error}",))
                measured[fault].append(reaction)
                verdict = "; ".join(reaction.failures) or "ok"
                print(
                    f"{fault.name}: rod {1e3 * reaction.rest:.0f} ms, coil {1e3 * reaction.coil:.0f} ms, "
                    f"{time.monotonic() - begin:.1f} s; {verdict}",
                    file=sys.stderr,
                    flush=True,
                )
                if reaction.failures:
                    print(*bench.story(), sep="\n", file=sys.stderr, flush=True)
                    break
    return list(measured.items())


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(prog="faults", description=__doc__)
    parser.add_argument("--rows", default="", metavar="REGEX", help="only faults whose names match")
    parser.add_argument("--moments", type=int, default=3, help="random moments for each fault of a process (default: 3)")
    parser.add_argument("--repeat", type=int, default=1, help="how often each other fault is tried (default: 1)")
    parser.add_argument("--times", type=int, default=1, help="how often the campaign is run (default: 1)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random moments and of the sensors' noise")
    arguments = parser.parse_args()
    faults = [fault for family in FAMILIES for fault in family.FAULTS if re.search(arguments.rows, fault.name)]
    claim_domain()
    failed = 0
    for k in range(arguments.times):
        begin = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            rows = run(faults, arguments.moments, arguments.repeat, arguments.seed + 1000 * k, Path(folder))
        bad = sum(any(reaction.failures for reaction in reactions) for _, reactions in rows)
        failed += bad
        print(table(rows))
        count = sum(len(reactions) for _, reactions in rows)
        print(f"\n{k + 1} of {arguments.times}: {count} runs in {time.monotonic() - begin:.0f} s,", end=" ")
        print(f"{bad} of {len(rows)} faults beyond their limits\n", flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

"""Check whether a drive is strong and fast enough for a damper.

The equations are Eqs 4–8 of the paper that this bench follows, "Characterization and Testing Bench Design for
Magnetorheological Dampers". The defaults are its drive, and the table shows its figures beside those computed here.
"""

import argparse

from rich.table import Table

from mrd_base import run_tool
from mrd_base.console import print_table
from mrd_bench_driver.sizing import Sizing, compare

# By option: field, number of the option's units in an SI unit, and meaning.
_OPTIONS = {
    "torque-Nm": ("torque", 1.0, "continuous torque of the motor"),
    "peak-torque-Nm": ("peak_torque", 1.0, "peak torque of the motor"),
    "ratio": ("ratio", 1.0, "ratio of the gearbox"),
    "efficiency": ("efficiency", 1.0, "efficiency of the gearbox"),
    "pinion-mm": ("pinion", 1e3, "pitch diameter of the pinion"),
    "module-mm": ("module", 1e3, "module of pinion and rack"),
    "no-load-rpm": ("no_load_speed", 60.0, "motor speed without load at its rated voltage"),
    "rated-V": ("rated_voltage", 1.0, "rated voltage of the motor"),
    "rated-A": ("rated_current", 1.0, "motor current at the continuous torque"),
    "supply-V": ("supply_voltage", 1.0, "voltage of the supply"),
    "supply-A": ("supply_current", 1.0, "current of the supply"),
    "load-N": ("load", 1.0, "force that the tests need"),
    "damper-pp-N": ("damper_peak_to_peak", 1.0, "peak-to-peak force of the damper at full current"),
    "damper-off-pp-N": ("damper_off_peak_to_peak", 1.0, "peak-to-peak force of the damper without current"),
    "speed-mm-per-s": ("speed", 1e3, "rod speed that the tests need"),
}


def _work() -> None:
    parser = argparse.ArgumentParser(prog="sizing", description=__doc__, allow_abbrev=False)
    default = Sizing()
    for option, (field, factor, meaning) in _OPTIONS.items():
        value = getattr(default, field) * factor
        # The paper's Eq. 8 calls this the speed of the motor.
        names = [f"--{option}"] + (["--speed-rpm"] if option == "no-load-rpm" else [])
        parser.add_argument(*names, dest=field, type=float, default=value, help=f"{meaning} (default {value:g})")
    given = vars(parser.parse_args())
    sizing = Sizing(**{field: given[field] / factor for field, factor, _ in _OPTIONS.values()})

    table = Table(title="Drive of the bench")
    table.add_column("quantity")
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("paper prints", justify="right", no_wrap=True)
    table.add_column("remark")
    for row in compare(sizing):
        table.add_row(row.name, row.value, row.printed, row.remark)
    print_table(table, beneath={"remark"})


def main() -> None:
    """Entry point of ``ros2 run mrd_bench_driver sizing``."""
    run_tool(_work)

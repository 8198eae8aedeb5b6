"""Measure dead time and lag of the servo in a recorded run, for the file of a hybrid test."""

import argparse

from mrd_base import run_tool
from mrd_control.servo_delay import read_servo_delay


def main() -> None:
    """Entry point of ``ros2 run mrd_control delay``."""
    run_tool(work)


def work() -> None:
    """Read the bag, fit, print the lines."""
    parser = argparse.ArgumentParser(
        description="Measure dead time and lag of the servo between the setpoints and the rod of a recorded run; prints the "
        "lines for the file of a hybrid test."
    )
    parser.add_argument(
        "run", metavar="BAG", help="bag of a run of the generator, such as that of characterise/01_multisine.yaml"
    )
    found = read_servo_delay(parser.parse_args().run)
    print(
        f"# {found.delay_error * 1e3:.2f} and {found.lag_error * 1e3:.2f} ms standard error; of {found.error * 1e6:.0f} µm "
        f"rms between rod and setpoints, {found.left * 1e6:.0f} µm are left"
    )
    print(found.yaml(), end="")


if __name__ == "__main__":
    main()

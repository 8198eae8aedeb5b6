"""Sizing of the drive: compare force and speed of motor, gearbox, rack and supply with those of the damper (Eqs 4–8)."""

import math
from dataclasses import dataclass

from mrd_base import InputError

# Range of the inputs, within which no figure overflows or vanishes.
_MIN_INPUT, _MAX_INPUT = 1e-9, 1e9


@dataclass(frozen=True)
class Sizing:
    """Motor, gearbox, rack and pinion, supply and load, in SI units. The defaults are the paper's bench.

    Parameters
    ----------
    torque, peak_torque : float
        Continuous and peak torque of the motor in N·m (paper, Table 3).
    ratio, efficiency : float
        Ratio and efficiency of the gearbox.
    pinion, module : float
        Pitch diameter and module of the pinion in m.
    no_load_speed : float
        Speed of the motor without load in rev/s at ``rated_voltage``.
    rated_voltage, rated_current : float
        Rated voltage of the motor in V, and its current in A at the continuous torque.
    supply_voltage, supply_current : float
        Voltage in V and current in A of the power supply.
    load : float
        Force in N that the tests need.
    damper_peak_to_peak, damper_off_peak_to_peak : float
        Peak-to-peak force in N of the damper at full current (1 A, 5 cm/s) and without current (20 cm/s).
    speed : float
        Rod speed in m/s that the tests need.
    """

    torque: float = 1.45
    peak_torque: float = 3.39
    ratio: float = 40.0
    efficiency: float = 0.95
    pinion: float = 0.064
    module: float = 0.002
    no_load_speed: float = 5100 / 60
    rated_voltage: float = 48.0
    rated_current: float = 15.5
    supply_voltage: float = 37.0
    supply_current: float = 10.0
    load: float = 800.0
    damper_peak_to_peak: float = 2447.0
    damper_off_peak_to_peak: float = 667.0
    speed: float = 0.2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not _MIN_INPUT <= value <= _MAX_INPUT:
                raise InputError(f"{name} is {value:g}, expected a positive number, {_MIN_INPUT:g} to {_MAX_INPUT:g}")
        if self.efficiency > 1:
            raise InputError(f"efficiency is {self.efficiency:g}, expected at most 1")
        teeth = self.pinion / self.module
        if abs(teeth - round(teeth)) > 1e-6 or teeth < 0.5:
            raise InputError(
                f"a pinion of {1e3 * self.pinion:g} mm with module {1e3 * self.module:g} mm has {teeth:.2f} teeth, "
                "expected a whole number; change --pinion-mm or --module-mm"
            )

    def rack_force(self, torque: float) -> float:
        """Return the force in N on the rack for a motor torque in N·m (Eq. 4)."""
        return torque / (self.pinion / 2) * self.efficiency * self.ratio

    def rack_speed(self, motor_speed: float) -> float:
        """Return the speed in m/s of the rack for a motor speed in rev/s (Eq. 8)."""
        return motor_speed / self.ratio * self.travel

    def motor_speed(self, rack_speed: float) -> float:
        """Return the motor speed in rev/s for a rack speed in m/s."""
        return rack_speed / self.travel * self.ratio

    @property
    def teeth(self) -> int:
        """Number of teeth of the pinion (Eq. 5)."""
        return round(self.pinion / self.module)

    @property
    def pitch(self) -> float:
        """Circular pitch in m (Eq. 6)."""
        return math.pi * self.pinion / self.teeth

    @property
    def travel(self) -> float:
        """Rack travel in m per pinion revolution (Eq. 7)."""
        return self.teeth * self.pitch

    @property
    def torque_constant(self) -> float:
        """Torque per current in N·m/A, from the continuous torque and its current."""
        return self.torque / self.rated_current

    @property
    def supplied_torque(self) -> float:
        """Continuous torque in N·m that the supply's current allows."""
        return min(self.torque, self.torque_constant * self.supply_current)

    @property
    def supplied_no_load_speed(self) -> float:
        """No-load speed in rev/s at the voltage of the supply, to which it is proportional."""
        return self.no_load_speed * self.supply_voltage / self.rated_voltage

    @property
    def shaft_power(self) -> float:
        """Power in W at the motor's shaft for the continuous torque at the needed speed."""
        return self.torque * 2 * math.pi * self.motor_speed(self.speed)

    @property
    def amplitude(self) -> float:
        """Force amplitude in N of the damper at full current."""
        return self.damper_peak_to_peak / 2


@dataclass(frozen=True)
class Row:
    """One row of the comparison: a quantity, its value, the figure that the paper prints, and a remark."""

    name: str
    value: str
    printed: str = ""
    remark: str = ""


def compare(sizing: Sizing) -> list[Row]:
    """Compare the correct figures with those that the paper prints.

    The remarks explain the figures of the paper's bench, whatever the drive.
    """
    return _drive_rows(sizing) + _load_rows(sizing) + _supply_rows(sizing)


def _drive_rows(s: Sizing) -> list[Row]:
    paper = Sizing()
    return [
        Row(
            "rack force, continuous (Eq. 4)",
            f"{s.rack_force(s.torque):.0f} N",
            "1800 N",
            f"Eq. 4 gives {paper.rack_force(paper.torque):.0f} N; 1800 N is the wanted force, not the result",
        ),
        Row("rack force, peak (Eq. 4)", f"{s.rack_force(s.peak_torque):.0f} N"),
        Row("pinion teeth (Eq. 5)", f"{s.teeth}", "32"),
        Row("circular pitch (Eq. 6)", f"{1e3 * s.pitch:.3f} mm", "6.28 mm"),
        Row("rack travel per revolution (Eq. 7)", f"{1e3 * s.travel:.2f} mm", "200.96 mm", "printed with π ≈ 3.14"),
        Row(
            "rack speed, no load (Eq. 8)",
            f"{100 * s.rack_speed(s.no_load_speed):.1f} cm/s",
            "20.93 cm/s",
            f"5100 rpm give {100 * paper.rack_speed(paper.no_load_speed):.1f} cm/s (and no torque); "
            f"20.93 cm/s belong to {60 * paper.motor_speed(0.2093):.0f} rpm",
        ),
        Row(
            f"rack speed, no load at {s.supply_voltage:g} V",
            f"{100 * s.rack_speed(s.supplied_no_load_speed):.1f} cm/s",
            "",
            "the no-load speed is proportional to the voltage",
        ),
        Row(f"motor speed at {100 * s.speed:g} cm/s", f"{60 * s.motor_speed(s.speed):.0f} rpm"),
    ]


def _load_rows(s: Sizing) -> list[Row]:
    force = s.rack_force(s.torque)
    return [
        Row(
            f"safety factor at {s.load:g} N",
            f"{force / s.load:.2f}",
            "2.25",
            "2.25 = 1800/800 takes the wanted force for the result",
        ),
        Row(
            "damper at full current, 5 cm/s",
            f"±{s.amplitude:.0f} N",
            "2447 N",
            "the printed figure is peak to peak: half of it on either side",
        ),
        Row(
            "damper without current, 20 cm/s",
            f"±{s.damper_off_peak_to_peak / 2:.0f} N",
            "< 7 N",
            "digits lost: < 667 N peak to peak; the text's 5 cm/s and 667 N mix both operating points",
        ),
        Row(f"safety factor at ±{s.amplitude:.0f} N", f"{force / s.amplitude:.2f}", "", "the paper does not compute it"),
    ]


def _supply_rows(s: Sizing) -> list[Row]:
    force, supplied = s.rack_force(s.torque), s.rack_force(s.supplied_torque)
    power = s.supply_voltage * s.supply_current
    limiting = power < s.shaft_power or supplied < force
    return [
        Row(
            f"rack force on {s.supply_current:g} A",
            f"{supplied:.0f} N",
            "",
            f"{s.torque_constant:.3f} N·m/A; the continuous torque takes {s.rated_current:g} A",
        ),
        Row(f"safety factor on {s.supply_current:g} A at {s.load:g} N", f"{supplied / s.load:.2f}"),
        Row(f"safety factor on {s.supply_current:g} A at ±{s.amplitude:.0f} N", f"{supplied / s.amplitude:.2f}"),
        Row(
            f"shaft power, {force:.0f} N at {100 * s.speed:g} cm/s",
            f"{s.shaft_power:.0f} W",
            "",
            "without the losses of the motor itself",
        ),
        Row(
            "power of the supply",
            f"{power:.0f} W",
            "37 V/10 A",
            "the supply is the limit, not the motor" if limiting else "",
        ),
    ]

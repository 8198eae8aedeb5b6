"""The simulated servomotor: drive and mechanics, command interpreter, serial line."""

from mrd_sim.motor.drive import Drive, MotorConfig, plan_position
from mrd_sim.motor.serial_line import SerialLine
from mrd_sim.motor.smart_motor import LINE_FAULTS, SmartMotor

__all__ = ["LINE_FAULTS", "Drive", "MotorConfig", "SerialLine", "SmartMotor", "plan_position"]

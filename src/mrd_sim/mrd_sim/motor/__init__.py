"""The simulated servomotor: servo axis, command interpreter, serial port. Written apart from the bench's driver."""

from mrd_sim.motor.serial_port import MotorSerialPort
from mrd_sim.motor.servo_axis import MotorConfig, ServoAxis
from mrd_sim.motor.smart_motor import LINE_FAULTS, SmartMotor

__all__ = ["LINE_FAULTS", "MotorConfig", "MotorSerialPort", "ServoAxis", "SmartMotor"]

"""The servomotor that moves the rod: its protocol, the serial line, the streaming of setpoints, and homing."""

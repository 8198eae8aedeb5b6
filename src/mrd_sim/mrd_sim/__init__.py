"""The simulator: damper models, effects, measuring chain, simulated motor and DAQ."""

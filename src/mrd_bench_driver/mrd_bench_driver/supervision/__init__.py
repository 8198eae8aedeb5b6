"""Supervision of the bench: modes, interlocks, the emergency stop, and the procedure of an experiment."""

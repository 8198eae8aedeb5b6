"""Simulators of the user's own: an FMU, a Python function, a command. They run in a process of their own."""

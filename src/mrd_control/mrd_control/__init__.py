"""The control set-up: emulated mechanical systems, excitations and control laws in a loop with a damper."""

"""Signals of a run: smoothed motion, current without sensor noise, phase of the mains hum, quantisation."""

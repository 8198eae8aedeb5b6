"""Setpoints of rod and coil: waveforms, transitions, experiments, limits, plans."""

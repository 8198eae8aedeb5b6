"""What the rod and the coil should do: waveforms, transitions, experiments, limits."""

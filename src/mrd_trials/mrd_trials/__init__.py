"""Blind trials of the diagnosis: plants with withheld effects, sealed answers, evaluation of the verdicts."""

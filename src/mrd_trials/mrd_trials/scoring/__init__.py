"""Scores of a trial: how often the verdicts are right, and how well calibrated, complete and localised they are.

A plant on which the diagnosis failed counts against it in every rate, closes nothing, and has a map that overlaps with
nothing, so that an error never improves a score.
"""

"""Identification of damper models from recordings, and comparison of models."""

from mrd_identification.compare import Comparison, compare
from mrd_identification.export import load_damper
from mrd_identification.fit import Fit
from mrd_identification.fit_file import read_fit, write_fit
from mrd_identification.identify import IdentificationTask, identify, identify_all
from mrd_identification.method import Method
from mrd_identification.metrics import Metrics, metrics

__all__ = [
    "Comparison",
    "Fit",
    "IdentificationTask",
    "Method",
    "Metrics",
    "compare",
    "identify",
    "identify_all",
    "load_damper",
    "metrics",
    "read_fit",
    "write_fit",
]

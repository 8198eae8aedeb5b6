"""What the recordings say: fit and gap."""

import importlib
from typing import TYPE_CHECKING, Any

from mrd_identification.compare import Comparison, compare
from mrd_identification.export import load_damper
from mrd_identification.fit_file import read_fit, write_fit
from mrd_identification.identify import Case, Fit, Method, identify, identify_all
from mrd_identification.metrics import Metrics, metrics

if TYPE_CHECKING:
    from mrd_identification.gap.diagnose import diagnose
    from mrd_identification.gap.diagnosis import Candidate, Cause, Diagnosis, Finding, Interval, Region
    from mrd_identification.gap.gap_file import read_gap_report
    from mrd_identification.gap.report import write_gap_report
    from mrd_identification.gap.trend import Trend, trend

_GAP = {
    "diagnose": "diagnose",
    **dict.fromkeys(("Candidate", "Cause", "Diagnosis", "Finding", "Interval", "Region"), "diagnosis"),
    "read_gap_report": "gap_file",
    "write_gap_report": "report",
    "Trend": "trend",
    "trend": "trend",
}
"""Module of each name that is imported when it is first used: whoever only fits need not wait for it."""


def __getattr__(name: str) -> Any:
    if name not in _GAP:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(importlib.import_module(f"{__name__}.gap.{_GAP[name]}"), name)


__all__ = [
    "Candidate",
    "Case",
    "Cause",
    "Comparison",
    "Diagnosis",
    "Finding",
    "Fit",
    "Interval",
    "Method",
    "Metrics",
    "Region",
    "Trend",
    "compare",
    "diagnose",
    "identify",
    "identify_all",
    "load_damper",
    "metrics",
    "read_fit",
    "read_gap_report",
    "trend",
    "write_fit",
    "write_gap_report",
]

"""Diagnosis of the gap between simulator and recordings: where it lies, which effect causes it, how far it closes."""

from mrd_diagnosis.diagnose import BEST_MODEL, diagnose
from mrd_diagnosis.diagnosis import Candidate, Cause, Diagnosis, Finding, Gap, Interval, Region
from mrd_diagnosis.localisation.sentence import where_sentence
from mrd_diagnosis.report.gap_file import read_gap_report
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.report.sentences import next_command
from mrd_diagnosis.report.validation_page import write_validation
from mrd_diagnosis.sequential.first_set import first_set
from mrd_diagnosis.sequential.sequential import SequentialDiagnosis, diagnose_sequentially
from mrd_diagnosis.trend.trend import Trend, trend
from mrd_diagnosis.validation.validate import ValidatedRun, Validation, validate

__all__ = [
    "BEST_MODEL",
    "Candidate",
    "Cause",
    "Diagnosis",
    "Finding",
    "Gap",
    "Interval",
    "Region",
    "SequentialDiagnosis",
    "Trend",
    "ValidatedRun",
    "Validation",
    "diagnose",
    "diagnose_sequentially",
    "first_set",
    "next_command",
    "read_gap_report",
    "trend",
    "validate",
    "where_sentence",
    "write_gap_report",
    "write_validation",
]

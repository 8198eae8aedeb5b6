"""What the recordings say: fit and gap."""

from mrd_identification.fit_file import read_fit, write_fit
from mrd_identification.identify import Fit, Method, identify
from mrd_identification.metrics import Metrics, metrics

__all__ = ["Fit", "Method", "Metrics", "identify", "metrics", "read_fit", "write_fit"]

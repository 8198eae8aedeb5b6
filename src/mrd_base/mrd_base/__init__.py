"""Base of all packages: input errors, configuration, bench time, exit status of tools, base of nodes."""

from mrd_base.clock import BenchClock
from mrd_base.config import from_mapping, node_patterns, quantity, read_node_parameters, read_yaml, to_mapping
from mrd_base.errors import FaultError, InputError
from mrd_base.tool import run_tool

__all__ = [
    "BenchClock",
    "FaultError",
    "InputError",
    "from_mapping",
    "node_patterns",
    "quantity",
    "read_node_parameters",
    "read_yaml",
    "run_tool",
    "to_mapping",
]

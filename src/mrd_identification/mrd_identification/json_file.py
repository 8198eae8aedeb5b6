"""JSON result files (`mrd_base.json_file`), and what they say of runs and versions."""

from importlib import metadata

from mrd_base.json_file import finite_or_none, make_folder, read_json, read_schema, write_json
from mrd_base.version import VERSION
from mrd_runs.summary import run_json

__all__ = ["finite_or_none", "make_folder", "read_json", "read_schema", "run_json", "versions", "write_json"]


def versions(*others: str) -> dict[str, str]:
    """Return the versions of this software, of its numerical libraries, and of ``others``."""
    libraries = ("numpy", "scipy", "numba", *others)
    return {"mrd_identification": VERSION, **{name: metadata.version(name) for name in libraries}}

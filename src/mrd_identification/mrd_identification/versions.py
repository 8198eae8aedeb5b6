"""The versions of this software and of the libraries that it computes with, for result files."""

from importlib import metadata

from mrd_base.version import VERSION


def versions(*others: str) -> dict[str, str]:
    """Return the versions of this software, of its numerical libraries, and of ``others``."""
    libraries = ("numpy", "scipy", "numba", *others)
    return {"mrd_identification": VERSION, **{name: metadata.version(name) for name in libraries}}

"""Storage files of bags, read entry by entry within bounds of memory, whatever their state."""

from pathlib import Path

from mrd_runs.storage.entries import Channel, End, Entries, Gap, Message, Schema
from mrd_runs.storage.mcap_file import decompress_message, read_mcap
from mrd_runs.storage.metadata import RECOVERED_FROM, Metadata, read_metadata
from mrd_runs.storage.sqlite_file import read_sqlite

SUFFIXES = (".mcap", ".db3")


def read_storage(file: Path) -> Entries:
    """Yield the content of an ``.mcap`` or ``.db3`` file (`read_mcap`, `read_sqlite`)."""
    return read_sqlite(file) if file.suffix == ".db3" else read_mcap(file)


__all__ = [
    "RECOVERED_FROM",
    "SUFFIXES",
    "Channel",
    "End",
    "Gap",
    "Message",
    "Metadata",
    "Schema",
    "decompress_message",
    "read_metadata",
    "read_storage",
]

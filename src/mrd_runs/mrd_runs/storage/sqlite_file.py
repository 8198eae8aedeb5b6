"""SQLite files of bags: also those that were not closed, and those of which pages are missing."""

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from mrd_base import InputError
from mrd_runs.storage.entries import LARGEST_RECORD, Channel, End, Entries, Gap, Message, Schema
from mrd_runs.text import one_line

# What SQLite writes beside a file until a transaction is complete.
_JOURNALS = ("-journal", "-wal")
_NEEDED = {"topics": {"id", "name", "type", "serialization_format"}, "messages": {"id", "topic_id", "timestamp", "data"}}


def read_sqlite(path: Path) -> Entries:
    """Yield the content of a file: schemas, channels, messages, and a gap where rows cannot be read; `End` without one.

    The file and its folder are not changed: a transaction that was left open is completed or undone in a copy.

    Raises
    ------
    InputError
        When the file is no SQLite file, or no bag.
    """
    try:
        with _open(path) as database:
            columns = _columns(database)
            if not all(needed <= columns.get(table, set()) for table, needed in _NEEDED.items()):
                raise InputError(f"{path}: cannot be read as a bag (it has no tables of topics and messages)")
            schemas: dict[str, int] = {}
            if "message_definitions" in columns:
                rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
                for number, (name, encoding, text) in enumerate(rows, 1):
                    schemas[str(name)] = number
                    yield Schema(number, str(name), str(encoding), str(text))
            qos = "offered_qos_profiles" if "offered_qos_profiles" in columns["topics"] else "''"
            topics = database.execute(
                f"SELECT id, name, type, serialization_format, {qos} FROM topics ORDER BY id"
            ).fetchall()
            for number, name, message_type, encoding, profiles in topics:
                if str(message_type) not in schemas:
                    schemas[str(message_type)] = len(schemas) + 1
                    yield Schema(schemas[str(message_type)], str(message_type), "", "")
                metadata = {"offered_qos_profiles": str(profiles)}
                yield Channel(number, schemas[str(message_type)], str(name), str(encoding), metadata)
            yield from _read_messages(database)
    except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a bag ({one_line(error)}); expected a recording") from None


def _read_messages(database: sqlite3.Connection) -> Entries:
    query = "SELECT id, topic_id, timestamp, data FROM messages ORDER BY id"
    last = None
    try:
        for number, *row in database.execute(query):
            yield _message(row)
            last = number
        yield End()
    except sqlite3.Error as error:
        # Pages are missing or damaged. The rows behind them are read from the end.
        try:
            for number, *row in database.execute(f"{query} DESC"):
                if last is not None and number <= last:
                    break
                yield _message(row)
        except sqlite3.Error:
            pass
        yield Gap(0, 0, f"has pages that cannot be read ({one_line(error)})")


def _message(row: list[object]) -> Message:
    topic, stamp, data = row
    if not (isinstance(topic, int) and isinstance(stamp, int) and isinstance(data, bytes)):
        raise sqlite3.DataError("a message is not of numbers and bytes")
    return Message(topic, stamp, data)


@contextmanager
def _open(path: Path) -> Iterator[sqlite3.Connection]:
    with tempfile.TemporaryDirectory() as scratch:
        journals = [Path(f"{path}{suffix}") for suffix in _JOURNALS]
        if any(journal.exists() for journal in journals):
            for file in (path, *journals):
                if file.exists():
                    shutil.copyfile(file, Path(scratch, file.name))
            address = f"file:{quote(str(Path(scratch, path.name)))}"
        else:
            address = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
        with closing(sqlite3.connect(address, uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_RECORD)
            database.execute("PRAGMA trusted_schema = OFF")
            database.execute("PRAGMA writable_schema = ON")  # else a file that is too short is not opened at all
            yield database


def _columns(database: sqlite3.Connection) -> dict[str, set[str]]:
    """Return the stored columns of each ordinary table; views and computed columns may be endless, made from nothing."""
    tables = database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'")
    names = [name for name, _ in tables if name in ("topics", "messages", "message_definitions")]
    return {name: {column for _, column, *_ in database.execute(f"PRAGMA table_info({name})")} for name in names}

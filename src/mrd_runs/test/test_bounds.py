"""Files of strangers: small ones cannot fill the memory, take minutes, run code, or give more than one clear line."""

import ast
import json
import os
import resource
import sqlite3
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zstandard

import mrd_runs
from mrd_base import InputError
from mrd_runs import read_run
from mrd_runs.bag import BagWriter, read_bag
from mrd_runs.definitions import typestore
from mrd_runs.formats import csv_file
from mrd_runs.run_info import read_run_info
from mrd_runs.storage.entries import LARGEST_RECORD

TYPES = typestore()
MAGIC = b"\x89MCAP0\r\n"
HEADER = "time_s,position_m,current_A,force_N\n"
ADDRESSES = 3 * 2**30  # bytes of addresses that a reader may have; Python and its libraries have half of them

READ = """
import sys, time
from mrd_base import InputError
from mrd_runs import read_run
from mrd_runs.recovery import recover_bag
from pathlib import Path
for work in (read_run, lambda path: recover_bag(Path(path), Path(path + "_new")))[: int(sys.argv[2])]:
    try:
        work(sys.argv[1])
    except InputError as error:
        print(error)
"""


def refusals(path: Path, recovers: bool = False) -> list[str]:
    """Read a file in a process with little memory; return the lines with which reading and recovery refuse it."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))

    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path), str(1 + recovers)],
        preexec_fn=limit,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert time.monotonic() - begin < 30
    return done.stdout.splitlines()


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(data: bytes, size: int, compression: bytes = b"zstd") -> bytes:
    head = struct.pack("<QQQII", 0, 1, size, 0, len(compression)) + compression + struct.pack("<Q", len(data))
    return record(0x06, head + data)


def mcap(*records: bytes) -> bytes:
    footer = record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC
    return MAGIC + record(0x01, struct.pack("<I", 4) + b"ros2" + bytes(4)) + b"".join(records) + footer


@pytest.fixture(scope="module")
def bomb() -> bytes:
    """Eight gibibytes of zeros in a megabyte at most."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj()
    block = bytes(2**24)
    return b"".join([*(compressor.compress(block) for _ in range(512)), compressor.flush()])


@pytest.mark.parametrize("stated", [100, LARGEST_RECORD, 2**33, 2**63])
def test_chunk_that_is_a_bomb(tmp_path: Path, bomb: bytes, stated: int) -> None:
    file = tmp_path / "bomb.mcap"
    file.write_bytes(mcap(chunk(bomb, stated)))
    read, recovered = refusals(file, recovers=True)
    assert read.startswith(f"{file}: cannot be read as a bag (it holds a chunk of ")
    assert recovered.startswith(f"{file}: holds no message that can be recovered (bomb.mcap holds a chunk of ")


def test_many_chunks_that_are_large_together(tmp_path: Path) -> None:
    full = zstandard.ZstdCompressor(level=1).compress(record(0x80, bytes(2**26 - 9)))
    file = tmp_path / "many.mcap"
    file.write_bytes(mcap(*[chunk(full, 2**26)] * 300))
    assert file.stat().st_size < 2e6
    most = 2**28 + 50 * file.stat().st_size
    assert refusals(file) == [f"{file}: holds more than {most} bytes when decompressed; expected a recording"]


@pytest.mark.parametrize("length", [10**4, 2**31, 2**40, 2**63, 2**64 - 1])
@pytest.mark.parametrize("opcode", [0x01, 0x03, 0x05, 0x06, 0x09, 0x90])
def test_records_whose_lengths_lie(tmp_path: Path, whole_bag: bytes, read_or_refuse, opcode: int, length: int) -> None:
    file = tmp_path / "lie.mcap"
    lie = struct.pack("<BQ", opcode, length)
    for content in (MAGIC + lie, mcap(lie + bytes(100)), whole_bag[:43] + lie + whole_bag[43:]):
        file.write_bytes(content)
        assert isinstance(read_or_refuse(file), str)


def test_texts_and_chunks_whose_lengths_lie(tmp_path: Path, read_or_refuse) -> None:
    schema = struct.pack("<HI", 1, 2**32 - 1) + b"name"
    file = tmp_path / "lie.mcap"
    for content, reason in (
        (record(0x03, schema), "holds a text that is longer than its record"),
        (record(0x05, b"short"), "holds a message of 5 bytes"),
        (chunk(record(0x05, bytes(22))[:-1], 30, b""), "holds a chunk with a record that is longer than the chunk"),
        (chunk(b"", 0, b"a" * 17), "holds a chunk whose compression has a name of 17 bytes"),
        (chunk(b"", 0, b"brotli"), "unknown compression brotli, expected"),
        (record(0x05, bytes(22)), "does not define the topic of a message"),
    ):
        file.write_bytes(mcap(content))
        assert reason in read_or_refuse(file)


def test_more_messages_than_fit_into_memory(tmp_path: Path, columns, fill_bag, monkeypatch) -> None:
    fill_bag(tmp_path / "run", columns).close()
    monkeypatch.setattr("mrd_runs.bag.LARGEST_BAG", 2**20 // 64)
    with pytest.raises(InputError, match=r"run\.mcap: holds more than 0 MiB of messages to read; split it"):
        read_run(tmp_path / "run")


def test_file_with_damage_everywhere_is_searched_in_reasonable_time(tmp_path: Path, read_or_refuse) -> None:
    """Each place looks like one where records begin again."""
    file = tmp_path / "places.mcap"
    file.write_bytes(MAGIC + (b"\x0f\x04" + bytes(11) + b"\x03") * 10**6)
    begin = time.monotonic()
    assert isinstance(read_or_refuse(file), str)
    assert time.monotonic() - begin < 10


def test_sqlite_columns_that_are_made_of_nothing(tmp_path: Path) -> None:
    file = tmp_path / "bomb.db3"
    with sqlite3.connect(file) as database:
        database.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        database.execute("INSERT INTO topics VALUES (1, '/samples', 'mrd_interfaces/msg/BenchSamples', 'cdr')")
        database.execute(
            "CREATE TABLE messages"
            "(id INTEGER PRIMARY KEY, topic_id, timestamp, data GENERATED ALWAYS AS (zeroblob(60000000)))"
        )
        database.executemany("INSERT INTO messages(topic_id, timestamp) VALUES (1, ?)", [(i,) for i in range(200)])
    database.close()
    assert refusals(file) == [f"{file}: cannot be read as a bag (it has no tables of topics and messages)"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ((HEADER + "0,0,0,0\n" * 50).encode() + b"1" * 10**5, "has a line of more than 65536 characters"),
        (b"a," * 10**5 + b"\n", "has a line of more than 65536 characters"),
        (b'"' * 70_000, "has a line of more than 65536 characters"),
        ((HEADER + "\n" * (10**7 + 1)).encode(), "is larger than 512 MiB and 10000000 lines"),
        ((HEADER + "0\x0b" * 30_000 + "\n").encode() * 400, "is larger than 512 MiB and 10000000 lines"),
        ((HEADER + "0\u2028" * 16_000 + "\n").encode() * 700, "is larger than 512 MiB and 10000000 lines"),
    ],
)
def test_csv_files_without_end(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "run.csv").write_bytes(content)
    with pytest.raises(InputError, match=reason):
        read_run(tmp_path / "run.csv")


def test_csv_lines_as_long_as_allowed(tmp_path: Path, columns, write_csv) -> None:
    """Also those that cross the pieces in which the file is looked through."""
    text = write_csv(tmp_path / "run.csv", columns).read_text().splitlines()
    for longest in (csv_file.LONGEST_LINE - 1, csv_file.LONGEST_LINE, csv_file.LONGEST_LINE + 1):
        lines = [line.ljust(longest) if index % 50 == 1 else line for index, line in enumerate(text)]
        (tmp_path / "long.csv").write_text("\n".join(lines))
        if longest < csv_file.LONGEST_LINE:
            assert len(read_run(tmp_path / "long.csv")) == 1000
        elif longest > csv_file.LONGEST_LINE:
            with pytest.raises(InputError, match="has a line of more than"):
                read_run(tmp_path / "long.csv")


def test_sparse_file_is_not_read_to_its_end(tmp_path: Path) -> None:
    with (tmp_path / "run.csv").open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(InputError, match="has a line of more than"):
        read_run(tmp_path / "run.csv")


def test_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    for path in ("/dev/zero", tmp_path / "pipe.csv"):
        with pytest.raises(InputError, match="is neither a file nor a folder"):
            read_run(path)
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(InputError, match=r"is not an \.mcap or \.db3 file"):
        read_bag(tmp_path / "pipe.mcap")


def bomb_of_merges(depth: int) -> str:
    """YAML that a loader which expands merge keys makes into 2 ** depth keys."""
    return "".join(f"k{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" if i else "k0: &a0 {x: 1}\n" for i in range(depth))


@pytest.mark.parametrize("experiment", [bomb_of_merges(40), "[" * 10**5, "name: [&a [1], *a]\n", "name: " + "x" * 10**6])
def test_experiments_that_are_bombs(tmp_path: Path, columns, fill_bag, experiment: str) -> None:
    with fill_bag(tmp_path / "run", columns) as writer:
        writer.add_topic("/run_info", "std_msgs/msg/String", latched=True)
        facts = json.dumps({"experiment": experiment})
        writer.write_message("/run_info", 0, TYPES.types["std_msgs/msg/String"](facts))
    begin = time.monotonic()
    assert read_run(tmp_path / "run").info["experiment_name"] == ""
    assert time.monotonic() - begin < 10


@pytest.mark.parametrize("text", ["rosbag2_bagfile_information: {relative_file_paths: *a}", bomb_of_merges(40), "[" * 10**5])
def test_metadata_that_are_a_bomb(tmp_path: Path, columns, fill_bag, text: str) -> None:
    fill_bag(tmp_path / "run", columns).close()
    (tmp_path / "run/metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=r"metadata\.yaml: is not the metadata of a bag"):
        read_run(tmp_path / "run")
    (tmp_path / "run/metadata.yaml").write_text("#" * 5_000_000)
    with pytest.raises(InputError, match=r"metadata\.yaml: is longer than 4194304 bytes"):
        read_run(tmp_path / "run")


def test_metadata_name_no_file_elsewhere(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "other", columns).close()
    fill_bag(tmp_path / "run", columns).close()
    metadata = tmp_path / "run/metadata.yaml"
    metadata.write_text(metadata.read_text().replace("run.mcap", "../other/other.mcap"))
    with pytest.raises(InputError, match="the bag's storage file is missing"):
        read_run(tmp_path / "run")


@pytest.mark.parametrize(
    "facts",
    [
        {"notes": 3, "seed": [[[]]], "versions": 1, "calibration": {"force": {"gain": "x"}, "device": {}}},
        {"notes": [{}, "kept"], "lost": "many", "recovered": "yes", "experiment_name": {}},
        [],
    ],
)
def test_facts_of_other_kinds_are_ignored(tmp_path: Path, columns, fill_bag, facts: object) -> None:
    with fill_bag(tmp_path / "run", columns) as writer:
        writer.add_topic("/run_info", "std_msgs/msg/String", latched=True)
        writer.write_message("/run_info", 0, TYPES.types["std_msgs/msg/String"](json.dumps(facts)))
    run = read_run(tmp_path / "run")
    assert (run.info["lost"], run.info["recovered"]) == (0, False)
    assert set(run.info["notes"]) <= {"kept"}
    assert "seed" not in run.info
    assert read_run_info(read_bag(tmp_path / "run")).get("calibration", {}) == {}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x/msg/Y:\n    import os; os.mkdir('{0}')\nclass Z", "uint8 a\n"),
        ("x/msg/Y", 'string A=\'"); __import__("os").mkdir("{0}") #\'\nuint8 a\n'),
        ("x/msg/Y", "string a \"'); __import__('os').mkdir('{0}')#\"\n"),
        ("x/msg/Y", "uint8 a); __import__('os').mkdir('{0}'\n"),
        ("x/msg/Y", "uint8[<=3] a\nx/Z[__import__('os').mkdir('{0}')] b\n"),
    ],
)
def test_definitions_run_no_code(tmp_path: Path, name: str, text: str) -> None:
    """rosbags makes Python code of the definitions in a bag."""
    target = tmp_path / "made"
    parts = [part.format(target).encode() for part in (name, text)]
    encoded = [struct.pack("<I", len(part)) + part for part in (parts[0], b"ros2msg", parts[1])]
    channel = struct.pack("<HH", 1, 1) + b"".join(struct.pack("<I", len(part)) + part for part in (b"/samples", b"cdr", b""))
    message = struct.pack("<HIQQ", 1, 0, 1, 1) + b"\0\1\0\0\0\0\0\0"
    file = tmp_path / "code.mcap"
    file.write_bytes(
        mcap(record(0x03, struct.pack("<H", 1) + b"".join(encoded)), record(0x04, channel), record(0x05, message))
    )
    try:
        bag = read_bag(file)
        bag.decode("/samples")
    except Exception:  # it does not matter why the file is unusable
        pass
    assert not target.exists()


def test_no_package_code_runs_what_it_reads() -> None:
    """No pickle, no eval, no shell; YAML only by a loader that makes plain values."""
    forbidden = {"pickle", "marshal", "shelve", "dill", "joblib", "subprocess", "ctypes", "code", "runpy"}
    allowed = {"matlab.py": {"subprocess"}}  # it starts Python with a constant text, for a file that may end its reader
    sources = list(Path(mrd_runs.__file__).parent.rglob("*.py"))
    assert len(sources) > 30
    for source in sources:
        for node in ast.walk(ast.parse(source.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            used = {name.partition(".")[0] for name in names} - allowed.get(source.name, set())
            assert not forbidden & used, source
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in (
                    "eval",
                    "exec",
                    "compile",
                    "__import__",
                    "os.system",
                    "os.popen",
                    "yaml.unsafe_load",
                ), source
                assert called != "yaml.load" or ast.unparse(node.args[1]) == "yaml.BaseLoader", source
                assert not any(keyword.arg == "allow_pickle" for keyword in node.keywords), source


def test_numbers_in_messages_that_are_impossible(tmp_path: Path, columns, make_block, read_or_refuse) -> None:
    """Values that overflow, and periods that no bench has."""
    for number, (field, value) in enumerate(
        [
            ("sample_period", 5e-324),
            ("sample_period", 1e308),
            ("sequence", 2**64 - 1),
            ("position", 1e308),
            ("force", -1e308),
        ]
    ):
        with BagWriter(tmp_path / f"run{number}") as writer:
            writer.add_topic("/samples", "mrd_interfaces/msg/BenchSamples")
            for first in range(0, 1000, 20):
                block = make_block(columns, first, first + 20)
                if first == 480:
                    setattr(block, field, value if np.isscalar(getattr(block, field)) else np.full(20, value))
                writer.write_message("/samples", first, block)
        result = read_or_refuse(tmp_path / f"run{number}")
        assert not isinstance(result, str) or result.isprintable()

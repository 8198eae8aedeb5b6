"""Feed damaged and hostile input to everything that reads: each gives a result or one clear line, soon, in little memory.

Read are recordings (csv, mcap, db3, yaml, recover), files of other programs (text, xlsx, mat, h5, tdms), replies of the
motor, experiments, hybrid tests, goals, bench.yaml, plant.yaml, and JSON files.
Every input is a file of the corpus, changed at a few places: bits, bytes, numbers that state sizes, pieces that are doubled,
dropped or taken from another file. An input that reaches lines of the readers that none before it has reached is changed on.
The recordings in fuzz/corpus are written by `python fuzz/readers.py --make-corpus`.
"""

import argparse
import random
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any
from unittest import mock

import h5py
import numpy as np
import openpyxl
import scipy.io
from bench_inputs import bench_readers
from nptdms import ChannelObject, RootObject, TdmsWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

import mrd_base
import mrd_bench_driver
import mrd_control
import mrd_diagnosis
import mrd_identification
import mrd_runs
import mrd_sim
import mrd_trajectory
from mrd_base import InputError
from mrd_runs import make_run, read_run
from mrd_runs.definitions import SAMPLES_TYPE, typestore
from mrd_runs.importing import Mapped, read_foreign
from mrd_runs.recovery import recover_bag
from mrd_runs.run_info import format_run_info
from mrd_runs.summary import summarise

CORPUS = Path(__file__).parent / "corpus"
TARGETS = (
    *("csv", "mcap", "db3", "yaml", "recover"),
    *("text", "xlsx", "mat", "h5", "tdms"),
    *("replies", "experiment", "control", "goal", "bench", "plant", "fit", "gap_report", "run_info"),
)
PACKAGES = (
    *(mrd_base, mrd_runs, mrd_trajectory, mrd_sim, mrd_bench_driver, mrd_identification, mrd_control, mrd_diagnosis),
)
SOURCES = tuple(str(Path(package.__file__ or "").parent) for package in PACKAGES)

LONGEST = 5.0  # s of the processor's time for an input
LONGEST_WAIT = 120.0  # s
LARGEST = 2**30  # bytes of memory beyond those before the first input
MOST_KEPT = 2000  # inputs that are changed further, for a target
INTERESTING = [0, 1, 7, 8, 9, 22, 255, 256, 2**15, 2**16 - 1, 2**26 + 1, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1]
TOKENS = [
    b"nan",
    b"inf",
    b"1e999",
    b"-0",
    b"\0",
    b"\n",
    b"\r",
    b",",
    b'"',
    b"\x1c",
    b"\xe2\x80\xa8",
    b"\xff",
    b"time_s",
    b"[/x]",
]
TOKENS += [
    b"&a ",
    b"*a",
    b"<<: ",
    b"{" * 50,
    b"[" * 50,
    b"!!python/object:os.system ",
    b"uint8[] ",
    b"string ",
    b"\x28\xb5\x2f\xfd",
]
TOKENS += [
    b"8000\r",
    b"-2147483648\r",
    b"65535\r",
    b"null",
    b"1e400",
    b"-1",
    b'{"a":' * 50,
    b": ",
    b"file: /dev/zero",
    b"3600.0",
]


def make_corpus() -> None:
    """Write the corpus: recordings of 60 samples in all formats, of this bench and of other programs."""
    CORPUS.mkdir(exist_ok=True)
    n, types, store = 60, typestore().types, typestore()
    time_s = np.arange(n) / 1000
    columns = [time_s, 0.01 * np.sin(60 * time_s), np.full(n, 0.15), 200 * np.cos(60 * time_s), -36 * np.sin(60 * time_s)]
    header = "time_s,position_m,current_A,force_N,acceleration_mps2"
    rows = [",".join(f"{value:.6g}" for value in row) for row in np.transpose(columns)]
    (CORPUS / "plain.csv").write_text("\n".join([header, *rows]) + "\n")
    quoted = [",".join(f'"{cell}"' for cell in row.split(",")) for row in [header, *rows]]
    (CORPUS / "quoted.csv").write_bytes(("\ufeff" + "\r\n".join(quoted)).encode())
    make_foreign_corpus(columns[:4])
    for name, plugin, mode in (
        ("plain", StoragePlugin.MCAP, CompressionMode.NONE),
        ("zstd", StoragePlugin.MCAP, CompressionMode.STORAGE),
        ("messages", StoragePlugin.MCAP, CompressionMode.MESSAGE),
        ("sqlite", StoragePlugin.SQLITE3, CompressionMode.NONE),
    ):
        with tempfile.TemporaryDirectory() as scratch:
            writer = Writer(Path(scratch, name), version=9, storage_plugin=plugin)
            writer.set_compression(mode, CompressionFormat.ZSTD)
            with writer:
                text = writer.add_connection("/run_info", "std_msgs/msg/String", typestore=store)
                samples = writer.add_connection("/samples", SAMPLES_TYPE, typestore=store)
                facts = format_run_info(experiment="name: demo\n", seed=1, notes=["a note"], calibration={"device": "none"})
                string = types["std_msgs/msg/String"](facts)
                writer.write(text, 0, store.serialize_cdr(string, "std_msgs/msg/String"))
                for first in range(0, n, 20):
                    stamp = types["builtin_interfaces/msg/Time"](5, first * 10**6)
                    series = [np.ascontiguousarray(columns[i][first : first + 20]) for i in (1, 3, 2, 4)]
                    block = types[SAMPLES_TYPE](types["std_msgs/msg/Header"](stamp, ""), 1e-3, first, *series, np.empty(0))
                    writer.write(samples, first * 10**6, store.serialize_cdr(block, SAMPLES_TYPE))
            for file in Path(scratch, name).iterdir():
                kind = file.suffix if file.suffix != ".yaml" else f"-{name}.yaml"
                (CORPUS / f"{name if kind == file.suffix else 'metadata'}{kind}").write_bytes(file.read_bytes())


def make_foreign_corpus(columns: list[np.ndarray]) -> None:
    """Write files as other programs do; the columns are time, position, current and force in SI units."""
    names = ["Time [s]", "Position [m]", "Current [A]", "Force [N]"]
    german = [";".join(f"{value:.6f}".replace(".", ",") for value in row) for row in np.transpose(columns)]
    spaced = ["  ".join(f"{value:12.6f}" for value in row) for row in np.transpose(columns)]
    (CORPUS / "text").mkdir(exist_ok=True)
    preamble = ["Prüfstand 3;;;", "Abtastrate;1000 Hz;;", ""]
    (CORPUS / "text/german.txt").write_text("\n".join([*preamble, ";".join(names), *german]) + "\n", "cp1252")
    (CORPUS / "text/spaces.dat").write_text("\n".join(["# a comment", "  ".join(names), *spaced]) + "\n", "utf-16")
    book = openpyxl.Workbook()
    for row in [names, *np.transpose(columns).tolist()]:
        book.active.append(row)
    book.save(CORPUS / "plain.xlsx")
    short = {name.split()[0].lower(): column for name, column in zip(names, columns, strict=True)}
    scipy.io.savemat(CORPUS / "plain.mat", {"log": short, "matrix": np.transpose(columns)})
    with h5py.File(CORPUS / "plain.h5", "w") as file:
        for name, column in short.items():
            file.create_dataset(f"log/{name}", data=column)
    with TdmsWriter(CORPUS / "plain.tdms") as writer:
        writer.write_segment([RootObject(), *(ChannelObject("log", name, column) for name, column in short.items())])


def change(content: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """Return a content that is changed at a few places."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(data) + 1)
        length = min(rng.choice((1, 2, 4, 8, 30, 300, len(data) // 4 + 1)), len(data) - at)
        kind = rng.randrange(9)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at : at + length] = rng.randbytes(length)
        elif kind == 2:
            layout = rng.choice(("<B", "<H", "<I", "<Q", "<d"))
            size = struct.calcsize(layout)
            value: Any = rng.choice(INTERESTING) % 2 ** (8 * size)
            if layout == "<d":
                value = rng.choice((float("nan"), float("inf"), 5e-324, 1e308, -1.0, 0.0))
            data[at : at + size] = struct.pack(layout, value)
        elif kind == 3:
            del data[at : at + length]
        elif kind == 4:
            data[at:at] = data[at : at + length] * rng.choice((1, 1, 2, 100))
        elif kind == 5:
            other = rng.choice(others)
            begin = rng.randrange(len(other) + 1)
            data[at:at] = other[begin : begin + rng.choice((8, 100, 1000))]
        elif kind == 6:
            data[at:at] = rng.choice(TOKENS) * rng.choice((1, 1, 1, 3))
        elif kind == 7:
            data[at : at + length] = bytes(length)
        elif rng.random() < 0.3:
            del data[at:]
    return bytes(data[:200_000])


def gradient(time_s: np.ndarray, position: np.ndarray, *_: Any) -> Any:
    """Stand in for the smoother, which is no reader and takes most of the time."""
    with np.errstate(all="ignore"):
        velocity = np.nan_to_num(np.gradient(position, time_s))
    return mock.Mock(velocity=velocity, note="", position_noise=0.0)


def readers(folder: Path) -> dict[str, Callable[[bytes], object]]:
    """Return for each target what is done with an input."""

    def read(name: str) -> Callable[[bytes], object]:
        def work(content: bytes) -> object:
            (folder / name).write_bytes(content)
            return summarise(read_run(folder / name))

        return work

    def read_foreign_file(name: str) -> Callable[[bytes], object]:
        def work(content: bytes) -> object:
            (folder / name).write_bytes(content)
            recording = read_foreign(folder / name, Mapped())
            return make_run("any", recording.columns, recording.info, where=name, place=recording.place)

        return work

    bag = folder / "bag"
    bag.mkdir()
    (bag / "messages.mcap").write_bytes((CORPUS / "messages.mcap").read_bytes())

    def read_folder(content: bytes) -> object:
        (bag / "metadata.yaml").write_bytes(content)
        return summarise(read_run(bag))

    def recover(content: bytes) -> object:
        (folder / "damaged.mcap").write_bytes(content)
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            return recover_bag(folder / "damaged.mcap", Path(scratch, "new"))

    return {
        "csv": read("any.csv"),
        "mcap": read("any.mcap"),
        "db3": read("any.db3"),
        "yaml": read_folder,
        "recover": recover,
        "text": read_foreign_file("any.txt"),
        **{ending: read_foreign_file(f"any.{ending}") for ending in ("xlsx", "mat", "h5", "tdms")},
        **bench_readers(folder),
    }


class Coverage:
    """Lines of the readers that inputs have reached."""

    def __init__(self) -> None:
        self.seen: set[tuple[str, int, int]] = set()
        self._functions: set[CodeType] = set()
        self._new = False

    @contextmanager
    def trace(self) -> Iterator[None]:
        self._new = False
        sys.settrace(self._on_call)
        try:
            yield
        finally:
            sys.settrace(None)

    @property
    def grew(self) -> bool:
        """Whether the latest input has reached new lines, or known ones in a new order."""
        return self._new

    def describe(self) -> str:
        """Return how much was reached; a step is from a line to the next."""
        lines = {
            (function.co_filename, line)
            for function in self._functions
            for _, _, line in function.co_lines()
            if line and line != function.co_firstlineno
        }
        reached = lines & {(file, line) for file, _, line in self.seen}
        share = 100 * len(reached) / max(1, len(lines))
        return f"{len(self.seen)} steps, {share:.0f} % of the lines of {len(self._functions)} functions reached"

    def _on_call(self, frame: FrameType, _event: str, _argument: object) -> Any:
        if not frame.f_code.co_filename.startswith(SOURCES):
            return None
        self._functions.add(frame.f_code)
        before = 0

        def on_line(frame: FrameType, event: str, _argument: object) -> Any:
            nonlocal before
            if event == "line":
                step = (frame.f_code.co_filename, before, frame.f_lineno)
                if step not in self.seen:
                    self.seen.add(step)
                    self._new = True
                before = frame.f_lineno
            return on_line

        return on_line


class TooLongError(Exception):
    """An input took too long."""


def expire(_signal: int, _frame: object) -> None:
    raise TooLongError


def judge(work: Callable[[bytes], object], content: bytes) -> str:
    """Return what is wrong with how an input was read; "" when nothing is."""
    begin = time.process_time()
    try:
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        signal.setitimer(signal.ITIMER_REAL, LONGEST_WAIT)
        work(content)
    except InputError as error:
        line = str(error)
        if not line.isprintable() or len(line) > 1000:
            return f"not one short line: {line[:200]!r}"
    except TooLongError:
        return f"took more than {LONGEST:g} s\n{traceback.format_exc()}"
    except BaseException:
        return traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "" if time.process_time() - begin < LONGEST else f"took more than {LONGEST:g} s"


def peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def fuzz(target: str, count: int, seconds: float, seed: int, failures: Path) -> int:
    """Read changed inputs, print what was found, and return the number of failures."""
    rng, coverage = random.Random(f"{target} {seed}"), Coverage()
    suffix = {"recover": "mcap"}.get(target, target)
    kept = [file.read_bytes() for file in sorted([*CORPUS.glob(f"*.{suffix}"), *CORPUS.glob(f"{target}/*")])]
    found: dict[str, int] = {}
    outcomes = {"read": 0, "refused": 0}
    with tempfile.TemporaryDirectory() as scratch:
        work = readers(Path(scratch))[target]

        def counted(content: bytes) -> object:
            outcomes["refused"] += 1
            result = work(content)
            outcomes["refused"] -= 1
            outcomes["read"] += 1
            return result

        for content in kept:
            with coverage.trace():
                if problem := judge(work, content):
                    print(f"{target}: a file of the corpus fails: {problem}", file=sys.stderr)
                    return 1
        begin, memory, done = time.monotonic(), peak_memory(), 0
        while done < count and time.monotonic() - begin < seconds:
            content = change(rng.choice(kept), kept, rng)
            with coverage.trace():
                problem = judge(counted, content)
            done += 1
            if not problem and peak_memory() - memory > LARGEST:
                problem, memory = "took more than a gibibyte", peak_memory()
            if problem:
                kind = problem.strip().splitlines()[-1][:120]
                if kind not in found:
                    path = failures / f"{target}-{len(found)}.{suffix}"
                    failures.mkdir(exist_ok=True, parents=True)
                    path.write_bytes(content)
                    print(f"{path}: {problem}", file=sys.stderr)
                found[kind] = found.get(kind, 0) + 1
            elif coverage.grew and len(kept) < MOST_KEPT:
                kept.append(content)
        elapsed = time.monotonic() - begin
    print(
        f"{target:10s} {done} inputs in {elapsed:.0f} s, {outcomes['read']} read, {len(kept)} kept, "
        f"{coverage.describe()}, {(peak_memory() - memory) >> 20} MiB more memory, "
        f"{sum(found.values())} failures of {len(found)} kinds",
        flush=True,
    )
    return sum(found.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", nargs="+", choices=TARGETS, default=TARGETS)
    parser.add_argument("--count", type=int, default=2000, help="inputs for each target")
    parser.add_argument("--seconds", type=float, default=600.0, help="longest time for each target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--failures", type=Path, default=Path("fuzz-failures"), help="folder for inputs that failed")
    parser.add_argument("--make-corpus", action="store_true", help="only write the corpus")
    arguments = parser.parse_args()
    if arguments.make_corpus:
        make_corpus()
        return
    warnings.simplefilter("error")
    for expired in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(expired, expire)
    smoother = ("mrd_runs.signals.motion.smooth_motion", gradient), ("mrd_runs.summary.smooth_motion", gradient)
    with mock.patch(*smoother[0]), mock.patch(*smoother[1]), mock.patch("os.fsync"):
        failed = [
            fuzz(target, arguments.count, arguments.seconds, arguments.seed, arguments.failures)
            for target in arguments.targets
        ]
    sys.exit(1 if any(failed) else 0)


if __name__ == "__main__":
    main()

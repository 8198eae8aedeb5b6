"""Make bags of recordings of other benches and programs, in SI units."""

import argparse
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_runs import Run, make_run
from mrd_runs.bag_import import bag_folder, write_bag
from mrd_runs.faults import find_faults
from mrd_runs.formats import Recording
from mrd_runs.importing import Mapped, find_files, read_passes, read_together
from mrd_runs.importing.preparation import Preparation, prepare
from mrd_runs.importing.rig import read_rig
from mrd_runs.importing.units import COLUMNS, check_quantity
from mrd_runs.read import checksum, unique_name


def main() -> None:
    """Entry point of ``mrd import``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, and make a bag of each file; no bag is left when one of them cannot be made."""
    arguments = _parser().parse_args()
    of_rig = read_rig(arguments.rig) if arguments.rig else Mapped()
    mapped = Mapped(
        {**of_rig.columns, **_pairs(arguments.map, "--map")},
        {**of_rig.topics, **_pairs(arguments.topics, "--topics")},
        {**of_rig.units, **_pairs(arguments.units, "--units")},
        tuple(check_quantity(name, "--flip") for name in arguments.flip) or of_rig.flip,
        of_rig.current if arguments.current is None else arguments.current,
        of_rig.rate if arguments.rate is None else arguments.rate,
    )
    mapped.check("--")
    wanted = Preparation(*_crop(arguments.crop), arguments.low_pass, arguments.decimate)
    files, skipped = find_files(arguments.files)
    for path in skipped:
        print(f"{path}: not read, because of its ending", file=sys.stderr)
    written: list[Path] = []
    new = [folder for folder in (arguments.output, *arguments.output.parents) if not folder.exists()]
    try:
        _import(files, mapped, wanted, arguments.output, written)
    except BaseException:
        for path in written:
            shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):  # a folder that holds something else stays
            for folder in new:
                folder.rmdir()
        raise


def _import(files: Sequence[Path], mapped: Mapped, wanted: Preparation, output: Path, written: list[Path]) -> None:
    known: dict[str, Path] = {}
    names: set[str] = set()
    for file, recordings in _read_all(files, mapped):
        stem = file.resolve().name if file.is_dir() else file.stem
        for number, recording in enumerate(recordings, 1):
            digest = checksum(recording.columns)
            if digest in known:
                raise InputError(f"{file}: is the same recording as {known[digest]}; give each recording once")
            name = unique_name(f"{stem}-{number}" if len(recordings) > 1 else stem, file, names)
            recording = prepare(recording, wanted, str(file))
            run = _make_run(name, recording, file)
            path = bag_folder(name, output)
            written.append(path)
            facts = {name: run.info[name] for name in ("started", "experiment", "clocks") if name in run.info}
            write_bag(recording.columns, run.info["notes"], file, path, facts)
            known[digest] = file
            names.add(name)
            print(f"{path}: {len(run)} samples, {run.duration:.6g} s at {run.rate:.6g} Hz")
            for note in run.info["notes"]:
                print(f"  {note}")
            for fault in find_faults([run]):
                print(f"warning: {fault}", file=sys.stderr)


def _make_run(name: str, recording: Recording, file: Path) -> Run:
    try:
        return make_run(name, recording.columns, recording.info, where=str(file), place=recording.place)
    except InputError as error:
        if "; is it in " in str(error):
            quantity = next((name for name, column in COLUMNS.items() if f" {column} " in str(error)), "QUANTITY")
            raise InputError(f"{error} Say so with --units {quantity}=UNIT") from None
        raise


def _read_all(files: Sequence[Path], mapped: Mapped) -> Iterator[tuple[Path, list[Recording]]]:
    """Yield the recordings in each file, or those of all files where each holds one channel of them."""
    together = read_together(files, mapped)
    if together is not None:
        yield files[0], together
        return
    for file in files:
        yield file, read_passes(file, mapped)


def _crop(text: str) -> tuple[float, float]:
    """Return the times of FROM:TO, either of which may be left out."""
    first, colon, last = text.partition(":")
    try:
        if text and not colon:
            raise ValueError
        return float(first or 0.0), float(last or "inf")
    except ValueError:
        raise InputError(f"--crop is {text}, expected FROM:TO in s, such as 2.5:20 or :20") from None


def _pairs(texts: Sequence[str], option: str) -> dict[str, str]:
    """Return QUANTITY=TEXT arguments as a mapping."""
    pairs = {}
    for text in texts:
        quantity, sign, value = text.partition("=")
        if not (sign and value):
            raise InputError(f"{option}: {text} is not a pair, expected QUANTITY=... with one of {', '.join(COLUMNS)}")
        if check_quantity(quantity, option) in pairs:
            raise InputError(f"{option}: {quantity} is given twice, expected once")
        pairs[quantity] = value
    return pairs


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="Delimiter, decimal sign, lines above the table, names and units of columns are found where the file tells "
        "them; else the answer is a mapping to start from, which was tried. Channels keep their own times until these have "
        "been compared; then they are put onto one time, or refused, and one line says what was done. A clock that was set "
        "back makes a bag of each pass. docs/own_data.md explains more.",
    )
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="text of any dialect, .xlsx, .mat, .h5, .tdms; a bag folder, .mcap or .db3; a folder or pattern of these; "
        "files of one channel each are one recording",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for the bags")
    parser.add_argument(
        "--map", nargs="+", default=[], metavar="QUANTITY=COLUMN", help=f"columns by their names: {', '.join(COLUMNS)}"
    )
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="QUANTITY=/TOPIC.FIELD", help="numbers in the messages of a bag"
    )
    parser.add_argument(
        "--units", nargs="+", default=[], metavar="QUANTITY=UNIT", help='or what one unit of the file is: force="200 N"'
    )
    parser.add_argument(
        "--flip", nargs="+", default=[], metavar="QUANTITY", help="turn the sign; force > 0 resists extension"
    )
    parser.add_argument("--current", type=float, metavar="A", help="constant coil current, where there is none")
    parser.add_argument("--rate", type=float, metavar="HZ", help="sample rate of files without time; resample a bag to it")
    parser.add_argument(
        "--rig",
        metavar="FILE.yaml",
        help="what the files of one rig do not tell, saved once: map, topics, units, flip, current, rate",
    )
    parser.add_argument("--crop", default="", metavar="FROM:TO", help="part to keep, in s from the first sample")
    parser.add_argument(
        "--low-pass", type=float, metavar="HZ", help="filter all signals alike, without delay; it hides faster effects"
    )
    parser.add_argument("--decimate", type=int, default=1, metavar="N", help="keep one of N samples, behind a filter")
    return parser


if __name__ == "__main__":
    main()

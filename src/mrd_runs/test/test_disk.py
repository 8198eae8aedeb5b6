"""The disk: what is on it at any time, and what is said when it is full or cannot be written."""

import errno
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_run
from mrd_runs.bag import FLUSH_PERIOD, SYNC_PERIOD, BagWriter, read_bag
from mrd_runs.bag_import import write_bag
from mrd_runs.definitions import SAMPLES_TYPE


@pytest.mark.realtime
def test_less_than_a_second_is_not_on_the_disk(tmp_path: Path, columns, make_block, monkeypatch) -> None:
    """What an fsync covered is what survives a power cut: the file up to its size at that time."""
    synchronised: list[tuple[float, int]] = []  # when, and size of the file
    real = os.fsync

    def fsync(descriptor: int) -> None:
        size = os.fstat(descriptor).st_size
        real(descriptor)
        synchronised.append((time.monotonic(), size))

    monkeypatch.setattr(os, "fsync", fsync)
    written: list[float] = []  # when each block was written
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/samples", SAMPLES_TYPE)
        synchronised.clear()
        begin = time.monotonic()
        for number in range(125):
            time.sleep(max(0.0, begin + 0.02 * number - time.monotonic()))
            block = make_block(columns, number % 50 * 20, number % 50 * 20 + 20)
            writer.write_message("/samples", number, block)
            written.append(time.monotonic())
        during, end = list(synchronised), time.monotonic()
    assert len(during) >= 4
    content = (tmp_path / "run/run.mcap").read_bytes()
    for cut in np.linspace(begin + 1, end, 20):
        size = max((size for at, size in during if at <= cut), default=0)
        (tmp_path / "cut.mcap").write_bytes(content[:size])
        kept = len(read_bag(tmp_path / "cut.mcap").topics["/samples"].messages)
        assert kept >= sum(at <= cut - 1 for at in written)
    assert FLUSH_PERIOD + SYNC_PERIOD < 1


def test_closed_bag_is_on_the_disk_with_its_metadata_and_its_name(tmp_path: Path, columns, fill_bag, monkeypatch) -> None:
    synchronised: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synchronised.append(os.readlink(f"/proc/self/fd/{descriptor}")))
    fill_bag(tmp_path / "run", columns).close()
    run = tmp_path / "run"
    assert [str(path) for path in (run / "run.mcap", run / "metadata.yaml", run)] == synchronised[-3:]
    assert str(tmp_path) in synchronised


def fail_after(monkeypatch: pytest.MonkeyPatch, writer: BagWriter, size: int) -> None:
    """Let the file of a writer take so many bytes more, and refuse the rest as a full disk does."""
    raw, left = writer._storage.bio, size

    class Full:
        def __getattr__(self, name: str) -> object:
            return getattr(raw, name)

        def write(self, data: bytes) -> int:
            nonlocal left
            part = bytes(data)[: max(left, 0)]
            left -= len(data)
            raw.write(part)
            if left < 0:
                raw.flush()
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return len(data)

    monkeypatch.setattr(writer._storage, "bio", Full())


@pytest.mark.parametrize("size", [0, 1, 100, 5000, 20_000])
def test_full_disk_leaves_the_messages_before(tmp_path: Path, columns, make_block, monkeypatch, size: int) -> None:
    writer = BagWriter(tmp_path / "run")
    writer.add_topic("/samples", SAMPLES_TYPE)
    fail_after(monkeypatch, writer, size)

    def fill() -> None:
        for number in range(200):
            block = make_block(columns, number % 50 * 20, number % 50 * 20 + 20)
            writer.write_message("/samples", number * 20_000_000, block)

    with pytest.raises(InputError) as caught:
        fill()
    line = str(caught.value)
    assert line.startswith(f"{tmp_path}/run: cannot be written (No space left on device; ")
    assert line.endswith(f" MB free in {tmp_path}/run); the messages before are kept")
    writer.close()
    assert not (tmp_path / "run/metadata.yaml").exists()
    if size >= 20_000:
        bag = read_bag(tmp_path / "run")
        assert bag.recovered
        assert 14 <= len(bag.topics["/samples"].messages) <= 30  # those of the chunks that were written whole
    else:
        assert (tmp_path / "run/run.mcap").stat().st_size < 12_000


def test_failing_synchronisation_is_told(tmp_path: Path, columns, make_block, monkeypatch) -> None:
    writer = BagWriter(tmp_path / "run")
    writer.add_topic("/samples", SAMPLES_TYPE)

    def fail(_descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fail)
    begin = time.monotonic()

    def fill() -> None:
        while time.monotonic() < begin + 5:
            writer.write_message("/samples", 1, make_block(columns, 0, 20))
            writer.flush()
            time.sleep(0.02)

    with pytest.raises(InputError, match=r"run: cannot be written \(Input/output error; "):
        fill()
    assert time.monotonic() - begin < 2 * SYNC_PERIOD + 0.5
    writer.close()


@pytest.mark.parametrize(("room", "samples"), [(100, 840), (6000, 1000)])
def test_full_disk_when_the_bag_is_closed(tmp_path: Path, columns, fill_bag, monkeypatch, room: int, samples: int) -> None:
    """There is room for nothing, or for the last messages but not for the end of the file."""
    writer = fill_bag(tmp_path / "run", columns)
    fail_after(monkeypatch, writer, room)
    with pytest.raises(InputError, match=r"run: cannot be written \(No space left on device; "):
        writer.close()
    writer.close()
    run = read_run(tmp_path / "run")
    assert len(run) >= samples
    assert run.info["recovered"]


@pytest.mark.parametrize("folder", ["/proc", "/dev/null"])
def test_folder_that_cannot_be_written_is_named(folder: str, columns) -> None:
    for work in (lambda path: BagWriter(path), lambda path: write_bag(columns, [], Path("run.csv"), path)):
        with pytest.raises(InputError, match=rf"^{folder}/x/run: cannot be made \(.*; \d+ MB free in /"):
            work(Path(folder, "x/run"))


def test_log_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    environment = {**os.environ, "ROS_LOG_DIR": str(tmp_path / "file/log")}
    done = subprocess.run(
        ["ros2", "run", "mrd_runs", "recorder"], env=environment, capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert f"{tmp_path}/file/log" in done.stderr
    assert done.stderr.count("\n") == 1

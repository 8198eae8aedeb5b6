"""Processes that compile at the same time do not get each other's code."""

import multiprocessing
from pathlib import Path

import pytest
from numba.core.caching import IndexDataCacheFile

from mrd_base.kernel_cache import write_one_at_a_time

WRITERS, SIGNATURES = 4, 25


def write(folder: str, writer: int, start: object) -> None:
    write_one_at_a_time()
    start.wait()
    for signature in range(SIGNATURES):
        index = IndexDataCacheFile(folder, "function", 0)
        index.save((writer, signature), f"code of {writer}, {signature}")


def test_what_processes_write_at_the_same_time_is_found_by_all(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    start = context.Barrier(WRITERS)
    writers = [context.Process(target=write, args=(str(tmp_path), writer, start)) for writer in range(WRITERS)]
    for process in writers:
        process.start()
    for process in writers:
        process.join()
        assert process.exitcode == 0
    index = IndexDataCacheFile(str(tmp_path), "function", 0)
    for writer in range(WRITERS):
        for signature in range(SIGNATURES):
            assert index.load((writer, signature)) == f"code of {writer}, {signature}"


def test_a_process_that_ends_while_it_writes_leaves_no_index_of_other_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(IndexDataCacheFile, "save", IndexDataCacheFile.save)
    write_one_at_a_time()
    IndexDataCacheFile(str(tmp_path), "function", "old source").save("key", "old code")
    new = IndexDataCacheFile(str(tmp_path), "function", "new source")

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(new, "_save_data", ended)
        with pytest.raises(KeyboardInterrupt):
            new.save("key", "new code")
    assert new.load("key") is None
    new.save("key", "new code")
    assert new.load("key") == "new code"

"""The whole bench as processes, for the tests of this folder."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from whole_bench import SharedBench, WholeBench


@pytest.fixture(scope="module")
def shared_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedBench]:
    """The bench of the tests of a module, which starts with the first of them."""
    with closing(SharedBench(tmp_path_factory.mktemp("bench"))) as shared:
        yield shared


@pytest.fixture
def bench(shared_bench: SharedBench) -> Iterator[WholeBench]:
    """The bench of the module: at rest in mode idle, and perhaps homed by an earlier test."""
    with shared_bench.lent() as bench:
        yield bench


@pytest.fixture
def whole_bench(shared_bench: SharedBench) -> type[WholeBench]:
    """A bench that the test starts itself. That of the module ends before, as it is in the same namespace."""
    shared_bench.close()
    return WholeBench


@pytest.fixture
def new_bench(whole_bench: type[WholeBench], tmp_path: Path) -> Iterator[WholeBench]:
    """A bench that has just been started, whose rod is not homed."""
    with whole_bench(tmp_path) as bench:
        yield bench

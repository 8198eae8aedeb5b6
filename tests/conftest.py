"""The whole bench as processes, for the tests of this folder."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from whole_bench import WholeBench


@pytest.fixture(scope="session")
def whole_bench() -> type[WholeBench]:
    """A bench that the test starts itself."""
    return WholeBench


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[WholeBench]:
    with WholeBench(tmp_path) as bench:
        yield bench

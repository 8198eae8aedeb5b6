"""Text files that a stranger names."""

import os
from pathlib import Path

import pytest

from mrd_base import InputError
from mrd_base.config import read_yaml
from mrd_base.text_file import read_text_file


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_text_is_read_with_or_without_a_mark(mark: bytes, tmp_path: Path) -> None:
    file = tmp_path / "text"
    file.write_bytes(mark + "stroke: 10 µm\n".encode())
    assert read_text_file(file, "a text") == "stroke: 10 µm\n"


def test_what_has_no_end_or_no_beginning_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(InputError, match=f"^{name}: is not a file, expected a YAML file$"):
            read_yaml(name)


def test_a_large_file_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "large.yaml").open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(InputError, match="has 1099511627776 bytes, expected a YAML file of at most 4194304"):
        read_yaml(tmp_path / "large.yaml")


@pytest.mark.parametrize(
    ("name", "line"),
    [("absent", "cannot be read .No such file"), ("a\0b", "cannot be read"), ("latin", "is not text .* at byte 3")],
)
def test_what_cannot_be_read_is_named_in_one_line(name: str, line: str, tmp_path: Path) -> None:
    (tmp_path / "latin").write_bytes(b"10 \xb5m")
    with pytest.raises(InputError, match=line):
        read_text_file(tmp_path / name, "a text")

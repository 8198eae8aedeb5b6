"""Tables on terminals of any width."""

import pytest
from rich.table import Table

from mrd_base.console import print_table

WORDS = ("one_long_name_of_an_effect", "a sentence of several words that has to be folded somewhere", "-15.25 to 15.25")


def printed(capsys):
    table = Table("name", "meaning", "range, mm")
    table.add_row(*WORDS)
    print_table(table)
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("width", [30, 66, 80, 200])
def test_text_is_folded_between_words_and_nothing_is_cut(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    lines = printed(capsys)
    shown = " ".join(lines).replace("│", " ").split()
    assert all(shown.count(word) >= 1 for text in WORDS for word in text.split())
    assert not any("…" in line for line in lines)
    if width >= 66:
        assert max(map(len, lines)) <= width


def test_a_file_has_no_width_to_fold_for(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert any(all(text in line for text in WORDS) for line in printed(capsys))

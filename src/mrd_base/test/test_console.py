"""Tables on terminals of any width."""

import pytest
from rich.markup import escape
from rich.table import Column, Table

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


def with_remark():
    table = Table("name", Column("value", justify="right"), "remark")
    table.add_row(
        "first", "1.5 N", "a remark of more than one hundred characters, which a narrow column would break into many lines"
    )
    table.add_row("second", "20 N", "")
    table.add_row("third", "300 N", escape("with [brackets]"))
    return table


def test_a_remark_stands_beneath_its_row_where_the_table_is_wider_than_the_terminal(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    print_table(with_remark(), beneath={"remark"})
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        " name    value",
        " first   1.5 N",
        "    a remark of more than one hundred characters, which a",
        "    narrow column would break into many lines",
        " second   20 N",
        " third   300 N",
        "    with [brackets]",
    ]


def test_a_remark_stands_in_its_column_where_there_is_room(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")
    print_table(with_remark(), beneath={"remark"})
    assert "│ third  │ 300 N │ with [brackets]" in capsys.readouterr().out


def test_a_column_without_a_box_uses_the_whole_width(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "19")
    table = Table("name", "value", box=None)
    table.add_row("two words", "30 N/m")
    print_table(table)
    assert capsys.readouterr().out.splitlines()[1].split("  ")[0].strip() == "two words"

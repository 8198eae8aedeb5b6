"""The thresholds and their table in the documentation."""

from dataclasses import fields
from pathlib import Path

from mrd_diagnosis.thresholds import THRESHOLDS, markdown_table

PAGE = Path(__file__).parents[3] / "docs" / "diagnosis.md"


def test_the_documentation_has_the_table_of_thresholds():
    _, _, rest = PAGE.read_text(encoding="utf-8").partition("<!-- thresholds -->\n")
    table, end, _ = rest.partition("<!-- /thresholds -->")
    assert end, "docs/diagnosis.md has no lines <!-- thresholds --> and <!-- /thresholds -->"
    assert table == markdown_table()


def test_every_threshold_has_a_meaning_and_the_trials_on_which_it_was_chosen():
    for threshold in fields(THRESHOLDS):
        assert threshold.metadata["meaning"], threshold.name
        assert threshold.metadata["chosen_on"], threshold.name

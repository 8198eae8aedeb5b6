"""Columns of numbers in CSV files."""

import numpy as np
import pytest

from mrd_base import InputError
from mrd_base.table import check_columns, read_csv


def test_columns_are_read_by_their_names_and_samples_placed_by_their_lines(tmp_path):
    (tmp_path / "a.csv").write_text("b,remark,time_s\n\n1.5,x,0\n2.5,y,0.1\n")
    table = read_csv(tmp_path / "a.csv", ("time_s", "b"), ("c",))
    np.testing.assert_array_equal(table.columns["time_s"], [0, 0.1])
    np.testing.assert_array_equal(table.columns["b"], [1.5, 2.5])
    assert (table.ignored, table.place(1)) == (["remark"], "line 4")


def test_checks_name_the_first_sample_that_fails(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,b\n0,1\n0.2,nan\n0.1,3\n")
    table = read_csv(tmp_path / "a.csv", ("time_s",), ("b",))
    with pytest.raises(InputError, match=r"^a: holds 3 samples, expected at least 4$"):
        check_columns(table.columns, 4, "a", table.place)
    with pytest.raises(InputError, match=r"^a: line 3: b is nan, expected a finite number$"):
        check_columns(table.columns, 3, "a", table.place)
    with pytest.raises(InputError, match=r"^a: line 4: time_s is 0.1 after 0.2, expected increasing time$"):
        check_columns({"time_s": table.columns["time_s"]}, 3, "a", table.place)

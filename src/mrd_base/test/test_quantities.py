"""Numbers as texts write them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base.quantities import per_cent, range_figures


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0556, "5.56 %"),
        (0.5, "50 %"),
        (1.0, "100 %"),
        (0.9996, "99.96 %"),
        (0.999964, "99.996 %"),
        (0.99999999, "more than 99.9999 %"),
        (0.0, "0 %"),
        (-0.02, "−2 %"),
        (12.0, "1200 %"),
    ],
)
def test_a_share_in_per_cent(share, text):
    assert per_cent(share) == text


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_what_is_not_the_whole_never_reads_as_the_whole(share):
    assert per_cent(share) != "100 %"


@pytest.mark.parametrize(
    ("lower", "upper", "text"),
    [
        (-0.0004897, 6.105, "0 to 6.105"),
        (43.0, 63.0, "43 to 63"),
        (-1.02345, 98.7654, "-1.02 to 98.77"),
        (0.0, 0.0, "0 to 0"),
        (12345.6, 23456.7, "12350 to 23460"),
        (float("nan"), 2.0, "nan to 2"),
    ],
)
def test_the_ends_of_a_range_have_equal_decimals(lower, upper, text):
    assert range_figures(lower, upper) == text

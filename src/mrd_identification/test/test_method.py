"""The options of an identification are read from texts, and refused in one line."""

import pytest

from mrd_base import InputError
from mrd_identification.method import Method, parse_method


def test_texts_become_a_method():
    method = parse_method(laws="viscous=tanh", fixed=["offset=0", "shape=0.5"], effects=("moving_mass",), seed=3, seeds=2)
    assert method == Method(
        laws={"viscous": "tanh"}, fixed={"offset": 0.0, "shape": 0.5}, effects=("moving_mass",), seed=3, seeds=2
    )
    assert list(method.search_seeds) == [3, 4]
    assert method.total_generations == 50
    assert list(parse_method(seed=3, least_squares=False).search_seeds) == [3]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fixed": ["offset"]}, "fixed parameter offset: expected PARAMETER=VALUE with a number"),
        ({"fixed": ["offset=much"]}, "fixed parameter offset=much: expected PARAMETER=VALUE with a number"),
        ({"laws": "viscous="}, "current law: viscous= is no current law"),
        ({"loss": "absolute"}, "loss 'absolute': expected linear, soft_l1, huber"),
        ({"population": 7}, "population 7, .*expected at least 8, 1 and 1"),
        ({"seed": -1}, "seed is -1, expected a whole number of 0 or more"),
    ],
)
def test_a_text_that_is_not_of_its_form_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        parse_method(**options)

"""The options of an identification are read from texts, and refused in one line."""

import argparse

import pytest

from mrd_base import InputError
from mrd_identification.cli.options import add_method_arguments, read_method
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
        ({"laws": "viscous="}, "current law: viscous= is not a current law"),
        ({"loss": "absolute"}, "loss 'absolute': expected linear, soft_l1, huber"),
        ({"population": 7}, "population 7, .*expected at least 8, 1 and 1"),
        ({"seed": -1}, "seed is -1, expected a whole number of 0 or more"),
    ],
)
def test_a_text_that_is_not_of_its_form_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        parse_method(**options)


def test_options_of_the_tools_become_a_method():
    parser = argparse.ArgumentParser()
    add_method_arguments(parser)
    assert read_method(parser.parse_args([])) == Method(laws="", effects=[], fixed={}, freed=[])
    options = "--law tanh --effect moving_mass --fix offset=0 --free exponent --no-least-squares --no-profile --loss huber"
    assert read_method(parser.parse_args(options.split())) == Method(
        laws="tanh",
        effects=["moving_mass"],
        fixed={"offset": 0.0},
        freed=["exponent"],
        loss="huber",
        least_squares=False,
        profile=False,
    )
    with pytest.raises(InputError, match="workers of a cluster do not know the effects"):
        read_method(argparse.Namespace(scheduler="tcp://host:8786", effects_folder="effects", models_folder=""))

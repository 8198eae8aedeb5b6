"""Experiments are read from YAML and written to it; errors are one clear line."""

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trajectory.experiment import format_experiment, parse_experiment, read_experiment
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.sine import Sine

GOOD = {
    "name": "good",
    "duration_s": 10.0,
    "rate_hz": 100.0,
    "rod": {"waveform": "sine", "amplitude_mm": 5.0, "frequency_hz": 1.5},
    "coil": {"waveform": "prbs", "low_mA": 0.0, "high_mA": 150.0, "bit_s": 0.2},
}


def parse(mapping):
    return parse_experiment(yaml.safe_dump(mapping), "good.yaml")


def test_levels_are_mm_for_the_rod_and_mA_for_the_coil():
    experiment = parse(GOOD)
    assert experiment.rod == Sine(0.005, 1.5)
    assert experiment.coil == Prbs(0.0, 0.15, 0.2)
    assert (experiment.repeats, experiment.transition) == (1, "quintic")


def test_omitted_channels_are_constant_at_zero():
    experiment = parse({key: GOOD[key] for key in ("name", "duration_s", "rate_hz")})
    assert experiment.rod.level == experiment.coil.level == 0


def numbers(low, high):
    return st.floats(low, high).map(lambda value: float(f"{value:.6g}"))


waveforms = {
    channel: st.one_of(
        st.fixed_dictionaries(
            {"waveform": st.just("sine"), f"amplitude_{unit}": numbers(0, 50), "frequency_hz": numbers(0.1, 20)},
            optional={f"offset_{unit}": numbers(-20, 20)},
        ),
        st.fixed_dictionaries(
            {
                "waveform": st.just("staircase"),
                f"levels_{unit}": st.lists(numbers(-50, 500), min_size=1, max_size=6),
                "hold_s": numbers(0.01, 10),
            }
        ),
        st.fixed_dictionaries(
            {"waveform": st.just("triangle"), f"amplitude_{unit}": numbers(1, 50), f"slope_{unit}_per_s": numbers(1, 50)}
        ),
        st.fixed_dictionaries(
            {
                "waveform": st.just("chirp"),
                f"amplitude_{unit}": numbers(1, 50),
                "start_hz": numbers(0.1, 9),
                "end_hz": numbers(1, 9),
            },
            optional={"constant_speed": st.booleans()},
        ),
    )
    for channel, unit in (("rod", "mm"), ("coil", "mA"))
}
mappings = st.fixed_dictionaries(
    {
        "name": st.from_regex(r"[A-Za-z0-9_-]{1,64}", fullmatch=True),
        "duration_s": numbers(0.1, 3600),
        "rate_hz": numbers(25, 2000),
        "rod": waveforms["rod"],
        "coil": waveforms["coil"],
    },
    optional={
        "repeats": st.integers(1, 1000),
        "transition": st.sampled_from(["linear", "cubic", "quintic"]),
        "description": st.text(st.characters(blacklist_categories=["Cs", "Cc"]), max_size=40),
    },
)


@given(mappings)
def test_an_experiment_is_read_back_from_its_yaml(mapping):
    experiment = parse(mapping)
    assert parse_experiment(format_experiment(experiment), "again") == experiment


def test_a_written_file_is_read_back(tmp_path):
    (tmp_path / "e.yaml").write_text(format_experiment(parse(GOOD)), encoding="utf-8")
    assert read_experiment(tmp_path / "e.yaml") == parse(GOOD)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"amplitude_mm": 5.0}, r"good.yaml: unknown key amplitude_mm \(known: name, "),
        ({"rod": {**GOOD["rod"], "amplitude_m": 0.005}}, "rod: unknown key amplitude_m; did you mean amplitude_mm"),
        ({"rod": {"waveform": "sine", "frequency_hz": 1.0}}, "good.yaml: rod: amplitude_mm is missing"),
        ({"rod": {"waveform": "sinus"}}, r"good.yaml: rod: unknown waveform sinus \(known: constant, sine"),
        ({"rod": {"waveform": ["sine"]}}, "good.yaml: rod: unknown waveform"),
        ({"rod": {"amplitude_mm": 5.0}}, "good.yaml: rod: expected a mapping with the key waveform"),
        ({"coil": 0.15}, "good.yaml: coil: expected a mapping"),
        ({"coil": {"waveform": "prbs", "low_mm": 0, "high_mA": 1, "bit_s": 1}}, "good.yaml: coil: unknown key low_mm"),
        ({"rod": {**GOOD["rod"], "amplitude_mm": math.nan}}, "amplitude_mm: found float nan, expected a finite number"),
        ({"rod": {**GOOD["rod"], "amplitude_mm": "5 mm"}}, "amplitude_mm: found str '5 mm', expected a finite number"),
        ({"rod": {**GOOD["rod"], "amplitude_mm": 1e300}}, r"rod: amplitude_mm: found 1e\+300, expected 0 to 50000"),
        ({"rod": {"waveform": "triangle", "amplitude_mm": 5.0, "slope_mm_per_s": 0.0}}, "slope_mm_per_s: found 0, expected"),
        ({"rate_hz": 24.9}, "good.yaml: rate_hz: found 24.9, expected 25 to 2000"),
        ({"rate_hz": 2001}, "good.yaml: rate_hz: found 2001, expected 25 to 2000"),
        ({"repeats": 1.5}, "good.yaml: repeats: found float 1.5, expected a whole number"),
        ({"duration_s": 0}, "good.yaml: duration_s: found 0, expected 0.01 to 3600"),
        ({"transition": "sudden"}, "good.yaml: transition: found 'sudden', expected one of linear, cubic, quintic"),
        ({"name": "../up"}, "good.yaml: name: found '../up', expected 1 to 64 letters"),
        ({"rod": {"waveform": "trace", "file": "a.csv"}}, "good.yaml: rod: file a.csv is relative"),
    ],
)
def test_wrong_experiments_are_refused_in_one_line(change, message):
    with pytest.raises(InputError, match=message) as caught:
        parse({**GOOD, **change})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1\n", "name: [", "\x00", "just words"])
def test_text_that_is_not_an_experiment_is_refused_in_one_line(text):
    with pytest.raises(InputError, match=r"^x\.yaml:") as caught:
        parse_experiment(text, "x.yaml")
    assert "\n" not in str(caught.value)


@given(st.text(max_size=200))
def test_any_text_is_refused_as_input(text):
    with pytest.raises(InputError):
        parse_experiment(text, "x.yaml")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.yaml: cannot be read"):
        read_experiment(tmp_path / "nothing.yaml")


def test_shipped_experiments_are_read():
    folder = Path(__file__).parents[3] / "config" / "experiments"
    names = {path.stem: read_experiment(path) for path in folder.glob("*.yaml")}
    paper = names["paper"]
    assert (paper.rod, paper.rate) == (Sine(0.005, 1.5), 25.0)
    assert (paper.coil.low, paper.coil.high) == (0.0, 0.15)
    assert all(experiment.name == stem for stem, experiment in names.items())

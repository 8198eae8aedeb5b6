import contextlib
import math
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError, from_mapping, quantity, read_node_parameters, read_yaml, to_mapping
from mrd_base.config import named_path, parse_yaml


@dataclass(frozen=True)
class Bounds:
    stroke: float = quantity(0.055, "mm", "travel of the damper", lower=1e-3, upper=0.1)
    current: float = quantity(1.0, "A", lower=-2, upper=2)


@dataclass(frozen=True)
class Settings:
    limits: Bounds = Bounds()
    amplitude: float = quantity(0.01, "mm")
    level: float = quantity(0.15, "level")
    count: int = quantity(3, doc="of repeats", lower=1, upper=10**6)
    port: str = quantity("/dev/ttyUSB0")
    enabled: bool = quantity(True)
    gains: tuple[float, ...] = quantity((1.0, 2.0), "mm")
    offset: float | None = quantity(None, "mm")


@dataclass(frozen=True)
class Ordered:
    high: float = quantity(doc="above low")
    low: float = quantity(0.0)

    def __post_init__(self):
        if not self.low < self.high:
            raise InputError(f"low is {self.low:g}, expected less than high, {self.high:g}")


UNITS = {"level": "mA"}
lengths = st.floats(-1e3, 1e3, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-12)
configs = st.builds(
    Settings,
    limits=st.builds(Bounds, stroke=st.floats(1e-3, 0.1), current=st.floats(-2, 2, allow_subnormal=False)),
    amplitude=lengths,
    level=lengths,
    count=st.integers(1, 10**6),
    port=st.text(),
    enabled=st.booleans(),
    gains=st.lists(lengths, min_size=1, max_size=4).map(tuple),
    offset=st.none() | lengths,
)


def numbers(config):
    fields = (config.limits.stroke, config.limits.current, config.amplitude, config.level, *config.gains)
    return [*fields, math.pi if config.offset is None else config.offset]


@given(configs)
def test_what_is_written_is_read_back(config):
    back = from_mapping(Settings, to_mapping(config, units=UNITS), "x", units=UNITS)
    assert numbers(back) == pytest.approx(numbers(config), rel=1e-14, abs=0)
    assert (back.count, back.port, back.enabled) == (config.count, config.port, config.enabled)


@given(st.integers(1000, 100_000))
def test_millimetres_become_the_nearest_float_in_metres(micrometres):
    """So that a number in YAML equals the default written in SI, and a bound includes its own value."""
    limits = from_mapping(Bounds, {"stroke_mm": micrometres / 1000}, "x")
    assert limits.stroke == micrometres / 1e6
    assert to_mapping(limits)["stroke_mm"] == micrometres / 1000


def test_keys_have_the_unit_and_nested_dataclasses_are_sections():
    assert to_mapping(Settings(), units=UNITS) == {
        "limits": {"stroke_mm": 55.0, "current_A": 1.0},
        "amplitude_mm": 10.0,
        "level_mA": 150.0,
        "count": 3,
        "port": "/dev/ttyUSB0",
        "enabled": True,
        "gains_mm": [1000.0, 2000.0],
    }


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"amplitud_mm": 1}, "demo.yaml: unknown key amplitud_mm; did you mean amplitude_mm? (known: "),
        ({"limits": {"stroke": 55}}, "demo.yaml: limits: unknown key stroke; did you mean stroke_mm? (known: "),
        ({"limits": {"stroke_mm": 0.055}}, "limits: stroke_mm: found 0.055, expected 1 to 100 (travel of the damper)"),
        ({"limits": {"stroke_mm": 100.0001}}, "found 100.0001, expected 1 to 100"),
        ({"limits": 55}, "demo.yaml: limits: found int 55, expected a mapping"),
        ({"amplitude_mm": "10"}, "amplitude_mm: found str '10', expected a finite number"),
        ({"amplitude_mm": math.nan}, "expected a finite number"),
        ({"amplitude_mm": 10**400}, "expected a finite number"),
        ({"amplitude_mm": True}, "found bool True, expected a finite number"),
        ({"amplitude_mm": None}, "found nothing, expected a finite number"),
        ({"count": 2.0}, "count: found float 2.0, expected a whole number (of repeats)"),
        ({"count": 10**400}, "expected 1 to 1e+06"),
        ({"enabled": "yes"}, "enabled: found str 'yes', expected bool"),
        ({"gains_mm": []}, "gains_mm: found list [], expected a list of at least one value"),
        ({"gains_mm": [1, "x"]}, "gains_mm[1]: found str 'x', expected a finite number"),
        ([], "demo.yaml: found list [], expected a mapping of names to values"),
    ],
)
def test_a_refusal_names_the_field_the_value_and_what_was_expected(mapping, message):
    with pytest.raises(InputError) as refusal:
        from_mapping(Settings, mapping, "demo.yaml", units=UNITS)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_missing_key_and_a_refusal_of_the_class_itself_name_the_file():
    with pytest.raises(InputError, match=r"^a.yaml: high is missing \(above low\)$"):
        from_mapping(Ordered, {}, "a.yaml")
    with pytest.raises(InputError, match=r"^a.yaml: low is 0, expected less than high, -1$"):
        from_mapping(Ordered, {"high": -1}, "a.yaml")


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
keys = st.sampled_from(["limits", "amplitude_mm", "level_mA", "count", "port", "enabled", "gains_mm", "offset_mm"])


@given(st.dictionaries(keys, json_like))
def test_any_mapping_is_accepted_or_refused(mapping):
    try:
        config = from_mapping(Settings, mapping, "x", units=UNITS)
    except InputError:
        return
    assert all(map(math.isfinite, numbers(config)))


@given(st.text())
def test_any_text_is_yaml_or_refused(text):
    with contextlib.suppress(InputError):
        assert isinstance(parse_yaml(text, "x"), dict)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1", "x: line 1 is not YAML"),
        ("a: 1\nb: @", "x: line 2 is not YAML"),
        ("a: 2001-99-99", "x: is not YAML (month must be in 1..12"),
        ("a: \0", "x: is not YAML"),
        ("[" * 3000, "x: is not YAML"),
        ("", "x: is empty, expected a mapping"),
        ("# nothing\n", "x: is empty, expected a mapping"),
        ("- 1", "x: holds list, expected a mapping"),
        ("a: 1\nb: 2\n'a': 3", "x: line 3 is not YAML (the key a appears twice, first in line 1; remove one)"),
        ("a:\n  b: {c: 1, c: 1}", "x: line 2 is not YAML (the key c appears twice, first in line 2; remove one)"),
    ],
)
def test_unusable_yaml_is_refused_in_one_line(text, message):
    with pytest.raises(InputError) as refusal:
        parse_yaml(text, "x")
    assert str(refusal.value).startswith(message)
    assert "\n" not in str(refusal.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere.yaml: cannot be read \(No such file"):
        read_yaml(tmp_path / "nowhere.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"bytes.yaml: is not text"):
        read_yaml(tmp_path / "bytes.yaml")


def test_the_section_of_a_node_overrides_the_shared_section(tmp_path):
    file = tmp_path / "bench.yaml"
    file.write_text("""
/**:
  ros__parameters: {time_scale: 1.0, limits: {stroke_mm: 55.0, current_A: 1.0}}
/**/servo:
  ros__parameters: {port: /dev/ttyS0, limits: {stroke_mm: 40.0}}
/**/daq:
  ros__parameters: {rate_hz: 25.0}
""")
    assert read_node_parameters(file, "servo") == {
        "time_scale": 1.0,
        "limits": {"stroke_mm": 40.0, "current_A": 1.0},
        "port": "/dev/ttyS0",
    }
    file.write_text("/**: {ros__parameters: {}}\n/**/servo: 3")
    with pytest.raises(InputError, match=r"bench.yaml: /\*\*/servo holds no ros__parameters mapping"):
        read_node_parameters(file, "servo")


@pytest.mark.parametrize("servo", ["3", "{port: x}", "{ros__parameters: 3}", "{ros__parameters: }"])
def test_a_section_without_parameters_is_refused(tmp_path, servo):
    file = tmp_path / "bench.yaml"
    file.write_text(f"/**: {{ros__parameters: {{}}}}\n/**/servo: {servo}")
    with pytest.raises(InputError, match=r"/\*\*/servo holds no ros__parameters mapping"):
        read_node_parameters(file, "servo")


@pytest.mark.parametrize("text", ["name: demo\nduration_s: 1", "a: {b: 1}", "/**: {time_scale: 1.0}", "/**:"])
def test_a_file_that_is_no_parameter_file_is_refused(tmp_path, text):
    file = tmp_path / "demo.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=r"demo.yaml: found .*, expected a parameter file \(`/\*\*: ros__parameters:`"):
        read_node_parameters(file, "servo")


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(["{!r}", "{:e}", "{:.0E}", "{:.17g}"]))
def test_every_way_to_write_a_float_is_read_as_number(value, form):
    text = form.format(value)
    read = parse_yaml(f"a: {text}", "x")["a"]
    assert isinstance(read, int | float)
    assert read == float(text)


@pytest.mark.parametrize(("text", "value"), [("1e3", 1e3), ("-2.E-3", -2e-3), (".5e+1", 5.0), ("12", 12), ("e3", "e3")])
def test_floats_are_those_of_yaml_1_2(text, value):
    read = parse_yaml(f"a: {text}", "x")["a"]
    assert (type(read), read) == (type(value), value)


def test_merged_mappings_hold_their_keys_once():
    assert parse_yaml("a: &a {x: 1, y: 2}\nb: {<<: *a, x: 3}\nc: *a", "x")["b"] == {"x": 3, "y": 2}


def test_a_text_that_would_take_for_ever_is_refused() -> None:
    with pytest.raises(InputError, match="text: has 1048577 characters, expected at most 1048576"):
        parse_yaml("#" * (2**20 + 1), "text")
    levels = ["a0: &a0 {x: 1}"] + [f"a{k + 1}: &a{k + 1} {{<<: [*a{k}, *a{k}]}}" for k in range(40)]
    with pytest.raises(InputError, match=r"is not YAML \(more than 10000 keys are merged\)"):
        parse_yaml("\n".join(levels), "text")


def test_a_path_that_cannot_be_is_refused(tmp_path: Path) -> None:
    assert named_path("~/runs") == Path.home() / "runs"
    assert named_path("~nobody-has-this-name") == Path.cwd() / "~nobody-has-this-name"
    with pytest.raises(InputError, match=r"^a\?b: holds a null character, expected the path of a file or folder$"):
        named_path("a\0b")
    with pytest.raises(InputError, match=r"a\?b: cannot be read"):
        read_yaml(tmp_path / "a\0b")

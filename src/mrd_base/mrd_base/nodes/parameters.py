"""The ROS parameters that the fields of a configuration become."""

import dataclasses
import math
import sys
import types
import typing
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from mrd_base.config import to_mapping, yaml_key

_TYPES = {float: "double", int: "integer", bool: "bool", str: "string"}


@dataclass(frozen=True)
class ParameterField:
    """A ROS parameter.

    Attributes
    ----------
    key : str
        Name of the parameter; it ends with the unit, if there is one.
    type : str
        ``double``, ``integer``, ``bool`` or ``string``, or an array of them.
    unit : str
        Unit of value, default and range.
    default : object
        Default value; "" for an optional parameter without one.
    lower, upper : float
        Inclusive bounds, which may be infinite.
    read_only : bool
        Whether it is only read at start.
    doc : str
        Meaning.
    """

    key: str
    type: str
    unit: str
    default: Any
    lower: float
    upper: float
    read_only: bool
    doc: str

    @property
    def range(self) -> str:
        """The range as text, or ""."""
        if math.isinf(self.lower) and math.isinf(self.upper):
            return ""
        if math.isinf(self.upper):
            return f"at least {self.lower:.15g}"
        return f"{self.lower:.15g} to {self.upper:.15g}"

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor of the parameter."""
        descriptor = ParameterDescriptor(
            description=self.doc,
            read_only=self.read_only,
            # `ros2 param set NODE rate_hz 100` gives an integer; an optional parameter without value is a string.
            dynamic_typing=not self.read_only or (self.default == "" and self.type != "string"),
        )
        if self.range:
            descriptor.additional_constraints = self.range
            if self.type == "double":
                largest = sys.float_info.max
                bounds = FloatingPointRange(from_value=max(self.lower, -largest), to_value=min(self.upper, largest))
                descriptor.floating_point_range = [bounds]
            elif self.type == "integer":
                lower, upper = max(self.lower, -(2**63)), min(self.upper, 2**63 - 1)
                descriptor.integer_range = [IntegerRange(from_value=int(lower), to_value=int(upper), step=1)]
        return descriptor


CLOCK = ParameterField(
    "clock",
    "string",
    "",
    "",
    -math.inf,
    math.inf,
    True,
    "socket of the owner of a simulated bench's time; empty on a real one",
)
"""The parameter that all nodes have."""


def parameter_fields(
    config_type: type, dynamic: Collection[str] = (), prefix: str = "", instance: Any = None
) -> Iterator[ParameterField]:
    """Yield the ROS parameters of a configuration.

    Parameters
    ----------
    config_type : dataclass type
        It has defaults for all fields, declared by `mrd_base.quantity`.
    dynamic : collection of str
        Keys of the parameters that may change while the node runs.
    """
    instance = config_type() if instance is None else instance
    defaults, hints = to_mapping(instance), typing.get_type_hints(config_type)
    for field in dataclasses.fields(config_type):
        key, factor = yaml_key(field)
        value, metadata = getattr(instance, field.name), field.metadata
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            yield from parameter_fields(type(value), dynamic, f"{prefix}{key}.", value)
            continue
        yield ParameterField(
            prefix + key,
            _type_name(hints[field.name]),
            metadata.get("unit", ""),
            defaults.get(key, ""),
            _scaled(metadata.get("lower", -math.inf), factor),
            _scaled(metadata.get("upper", math.inf), factor),
            prefix + key not in dynamic,
            metadata.get("doc", ""),
        )


def flatten(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings with their dotted keys."""
    for key, value in mapping.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _scaled(bound: float, factor: float) -> float:
    return float(f"{bound / factor:.15g}")


def _type_name(hint: Any) -> str:
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        (hint,) = [option for option in typing.get_args(hint) if option is not type(None)]
    if typing.get_origin(hint) is tuple:
        return f"{_TYPES[typing.get_args(hint)[0]]} array"
    return _TYPES[hint]

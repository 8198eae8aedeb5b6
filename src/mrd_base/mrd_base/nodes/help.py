"""Describe a node as its option ``--help`` prints it."""

import inspect
import textwrap
import typing
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from mrd_base.nodes.graph import ACTIONS, SERVICES, TOPICS, Topic, describe_qos, type_name
from mrd_base.nodes.parameters import CLOCK, ParameterField, parameter_fields

_WIDTH = 120


def node_parameters(node_class: Any) -> list[ParameterField]:
    """Return the parameters of a class of nodes."""
    return [*parameter_fields(config_type(node_class), node_class.dynamic), CLOCK]


def config_type(node_class: Any) -> type:
    """Return the type of the configuration of a class of nodes, the argument of its generic base."""
    for base in node_class.__mro__:
        for generic in getattr(base, "__orig_bases__", ()):
            for argument in typing.get_args(generic):
                if isinstance(argument, type):
                    return argument
    raise TypeError(f"{node_class.__name__} has no configuration; derive it from BenchNode[...]")


def describe_node(name: str, node_class: Callable[[], Any]) -> str:
    """Return the text of ``--help`` of the node that an executable runs.

    Parameters
    ----------
    name : str
        Name of executable and node.
    node_class : type
        Class of the node.
    """

    def topics(title: str, of: Callable[[Topic], tuple[str, ...]]) -> Iterator[str]:
        rows = [
            (topic.name, type_name(topic.type), f"{topic.doc} ({describe_qos(topic.qos)})")
            for topic in TOPICS
            if name in of(topic)
        ]
        yield from _section(title, rows)

    lines = [
        f"usage: {name} [--ros-args [-r __ns:=NAMESPACE] [--params-file FILE] [-p NAME:=VALUE] ...]",
        "",
        *textwrap.wrap(_paragraph(node_class), _WIDTH),
        *topics("publishes", lambda topic: topic.publishers),
        *topics("subscribes to", lambda topic: topic.subscribers),
        *_section("services", [(s.name, type_name(s.type), s.doc) for s in SERVICES if s.node == name]),
        *_section("actions", [(a.name, type_name(a.type), a.doc) for a in ACTIONS if a.node == name]),
        *_section("parameters", map(_parameter_row, node_parameters(node_class))),
        "",
        "Names are relative to the namespace. docs/ros.md describes the whole graph, docs/safety.md who may move the bench.",
    ]
    return "\n".join(lines)


def _paragraph(node_class: Any) -> str:
    """Return the first sentences of a class's docstring, up to the first section."""
    text = inspect.getdoc(node_class) or ""
    return " ".join(text.split("\nParameters\n")[0].split("\nAttributes\n")[0].replace("``", "").replace("`", "").split())


def _parameter_row(parameter: ParameterField) -> tuple[str, str, str]:
    limits = [parameter.range, "" if parameter.read_only else "may change while the node runs"]
    notes = "; ".join(filter(None, [parameter.doc, *limits]))
    default = "" if parameter.default == "" else f" = {format_value(parameter.default)}"
    return parameter.key, f"{parameter.type}{default}", notes


def format_value(value: Any) -> str:
    """Return a parameter's value as YAML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(format_value, value))}]"
    return str(value)


def _section(title: str, rows: Iterable[tuple[str, str, str]]) -> Iterator[str]:
    entries = list(rows)
    if entries:
        yield from ("", f"{title}:")
    for name, kind, doc in entries:
        yield f"  {name}  {kind}"
        yield from textwrap.wrap(doc, _WIDTH, initial_indent="      ", subsequent_indent="      ")

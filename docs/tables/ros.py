"""Writes the tables of docs/ros.md from the graph of the bench and the configurations of its nodes.

python docs/tables/ros.py            # writes them into the page
python docs/tables/ros.py --check    # fails where the page is not up to date
"""

import argparse
import importlib
import inspect
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from architecture import page_with

from mrd_base.nodes.bench_node import BenchNode
from mrd_base.nodes.graph import ACTIONS, NODES, SERVICES, TOPICS, describe_qos, type_name
from mrd_base.nodes.help import format_value, node_parameters
from mrd_base.nodes.parameters import CLOCK

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "ros.md"
# Every node has these from its base; they would hide the rest.
HIDDEN = {"/diagnostics"}


def node_classes() -> dict[str, tuple[str, Any]]:
    """Return package and class of every node, by its name: the executables in the folders ``nodes``."""
    found = {}
    for file in sorted((ROOT / "src").glob("mrd_*/mrd_*/nodes/*.py")):
        package, name = file.relative_to(ROOT / "src").parts[0], file.stem
        module = importlib.import_module(f"{package}.nodes.{name}")
        for node_class in vars(module).values():
            own = inspect.isclass(node_class) and node_class.__module__ == module.__name__
            if own and issubclass(node_class, BenchNode) and hasattr(module, "main"):
                found[name] = package, node_class
    if set(found) != set(NODES):
        raise SystemExit(f"mrd_base/nodes/graph.py has the nodes {', '.join(NODES)}, the packages have {', '.join(found)}")
    return found


def diagram() -> str:
    """Return the nodes as a Mermaid diagram; an arrow is a topic from its publisher to its subscriber."""
    arrows: dict[tuple[str, str], list[str]] = defaultdict(list)
    for topic in TOPICS:
        for source in topic.publishers if topic.name not in HIDDEN else ():
            # A replay stands in for the bench; its arrows would be those of servo and DAQ once more.
            for target in topic.subscribers if source != "replay" else ():
                if target not in (source, "recorder"):
                    arrows[source, target].append(topic.name)
    lines = ["```mermaid", "flowchart LR"]
    lines += [f"    {source} -->|{', '.join(sorted(names))}| {target}" for (source, target), names in sorted(arrows.items())]
    return "\n".join([*lines, "```"])


def table(titles: Sequence[str], rows: Iterator[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def code(names: Sequence[str]) -> str:
    """Return names in type of code."""
    return ", ".join(f"`{name}`" for name in names)


def topics() -> str:
    """Return the table of the topics."""
    titles = ("topic", "type", "QoS of the publisher", "publishers", "subscribers", "in bags", "what, when")
    rows = (
        (
            code([topic.name]),
            code([type_name(topic.type)]),
            describe_qos(topic.qos),
            ", ".join(topic.publishers),
            ", ".join(topic.subscribers),
            "yes" if topic.recorded else "",
            topic.doc,
        )
        for topic in TOPICS
    )
    return table(titles, rows)


def calls(entries: Sequence[Any], kind: str) -> str:
    """Return the table of the services or actions."""
    rows = ((code([entry.name]), code([type_name(entry.type)]), entry.node, entry.doc) for entry in entries)
    return table((kind, "type", "node", "what"), rows)


def parameters() -> str:
    """Return the tables of the parameters, one for each node."""
    titles = ("parameter", "type", "unit", "default", "range", "read-only", "meaning")
    sections = []
    for name, (package, node_class) in node_classes().items():
        rows = (
            (
                code([parameter.key]),
                parameter.type,
                parameter.unit,
                f"`{format_value(parameter.default)}`" if parameter.default != "" else "",
                parameter.range,
                "yes" if parameter.read_only else "no",
                parameter.doc,
            )
            for parameter in node_parameters(node_class)
            if parameter is not CLOCK
        )
        sections.append(f"### {name}\n\n`ros2 run {package} {name}`\n\n{table(titles, rows)}")
    return "\n\n".join(sections)


def main() -> None:
    """Write, check or print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing, fail where the page is not up to date")
    arguments = parser.parse_args()
    old = new = PAGE.read_text(encoding="utf-8")
    contents = {
        "graph": diagram(),
        "topics": topics(),
        "services": calls(SERVICES, "service"),
        "actions": calls(ACTIONS, "action"),
        "parameters": parameters(),
    }
    for name, content in contents.items():
        new = page_with(new, name, content, PAGE)
    if arguments.check and new != old:
        sys.exit(f"{PAGE}: is not up to date; run: python docs/tables/ros.py")
    PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()

"""Writes the tables of docs/ros.md, and the policies for SROS 2, from the graph of the bench and its nodes' configurations.

python docs/tables/ros.py            # writes them into the page
python docs/tables/ros.py --check    # fails where the page is not up to date
"""

import argparse
import importlib
import inspect
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sections import page_with, table

from mrd_base.nodes.bench_node import BenchNode
from mrd_base.nodes.graph import ACTIONS, NODES, SERVICES, TOPICS, describe_qos, type_name
from mrd_base.nodes.help import format_value, node_parameters
from mrd_base.nodes.parameters import CLOCK

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "ros.md"
POLICIES = ROOT / "src" / "mrd_bringup" / "security" / "policies.xml"
# The services that ROS gives every node.
PARAMETER_SERVICES = (
    "~/describe_parameters",
    "~/get_parameters",
    "~/get_parameter_types",
    "~/list_parameters",
    "~/set_parameters",
    "~/set_parameters_atomically",
)
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


def policies() -> str:
    """Return who may publish, subscribe and call what, as `ros2 security` reads it: one enclave for each node.

    Only the supervisor and the operator may call services of other nodes. The observer may subscribe, and nothing else.
    """
    names = [topic.name for topic in TOPICS]
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")

    def add(enclave: str, rules: dict[tuple[str, str], Sequence[str]]) -> None:
        element = ElementTree.SubElement(enclaves, "enclave", path=f"/bench/{enclave}")
        profiles = ElementTree.SubElement(element, "profiles")
        profile = ElementTree.SubElement(profiles, "profile", ns="/bench", node=enclave)
        for (kind, right), entries in rules.items():
            if entries:
                group = ElementTree.SubElement(profile, kind, {right: "ALLOW"})
                for entry in entries:
                    ElementTree.SubElement(group, kind[:-1]).text = entry

    of_all = ("/rosout", "/parameter_events")
    for node in NODES:
        others = [service.name for service in SERVICES if service.node != node]
        rules: dict[tuple[str, str], Sequence[str]] = {
            ("topics", "publish"): [*(topic.name for topic in TOPICS if node in topic.publishers), *of_all],
            ("topics", "subscribe"): [topic.name for topic in TOPICS if node in topic.subscribers],
            ("services", "reply"): [*(service.name for service in SERVICES if service.node == node), *PARAMETER_SERVICES],
            ("services", "request"): [*others, "daq/set_parameters"] if node == "supervisor" else [],
            ("actions", "execute"): [action.name for action in ACTIONS if action.node == node],
            ("actions", "call"): [action.name for action in ACTIONS if node in action.callers],
        }
        add(node, rules)
    stops = [topic.name for topic in TOPICS if "bench" in topic.publishers]
    everything: dict[tuple[str, str], Sequence[str]] = {
        ("topics", "publish"): [*stops, *of_all],
        ("topics", "subscribe"): names,
        ("services", "request"): [service.name for service in SERVICES],
        ("actions", "call"): [action.name for action in ACTIONS],
    }
    add("operator", everything)
    add("observer", {("topics", "publish"): of_all, ("topics", "subscribe"): names})
    ElementTree.indent(root)
    return f"<!-- Written by docs/tables/ros.py. -->\n{ElementTree.tostring(root, encoding='unicode')}\n"


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
    old_policies = POLICIES.read_text(encoding="utf-8") if POLICIES.exists() else ""
    for path, was, is_now in ((PAGE, old, new), (POLICIES, old_policies, policies())):
        if arguments.check and was != is_now:
            sys.exit(f"{path}: is not up to date; run: python docs/tables/ros.py")
        path.write_text(is_now, encoding="utf-8")


if __name__ == "__main__":
    main()

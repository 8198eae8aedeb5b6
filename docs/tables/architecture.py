"""Draws the diagrams of docs/architecture.md from the sources: packages with their imports, nodes with their topics.

python docs/tables/architecture.py            # writes them into the page
python docs/tables/architecture.py --check    # fails where the page is not up to date
"""

import argparse
import ast
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
PUBLISHING = {"create_publisher"}
SUBSCRIBING = {"create_subscription"}


def modules() -> Iterator[tuple[str, Path, ast.Module]]:
    """Yield package, file and syntax tree of every module."""
    for file in sorted((ROOT / "src").glob("mrd_*/mrd_*/**/*.py")):
        package = file.relative_to(ROOT / "src").parts[0]
        if file.relative_to(ROOT / "src").parts[1] == package:
            yield package, file, ast.parse(file.read_text(encoding="utf-8"))


def imports() -> Counter[tuple[str, str]]:
    """Count the modules of each package that import from another one; messages are left out."""
    pairs: set[tuple[str, str, Path]] = set()
    for package, file, tree in modules():
        for node in ast.walk(tree):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                other = name.partition(".")[0]
                if other.startswith("mrd_") and other not in (package, "mrd_interfaces"):
                    pairs.add((package, other, file))
    return Counter((package, other) for package, other, _ in pairs)


def reduced(edges: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Drop the arrows that a longer way implies (transitive reduction)."""
    below: dict[str, set[str]] = defaultdict(set)
    for upper, lower in edges:
        below[upper].add(lower)

    def reachable(start: str) -> set[str]:
        return {node for lower in below[start] for node in {lower} | reachable(lower)}

    return {(upper, lower) for upper, lower in edges if not any(lower in reachable(mid) for mid in below[upper] - {lower})}


def package_diagram() -> str:
    """Return the packages as a Mermaid diagram; an arrow means "uses"."""
    lines = ["```mermaid", "flowchart TD"]
    lines += [f"    {upper} --> {lower}" for upper, lower in sorted(reduced(set(imports())))]
    return "\n".join([*lines, "```"])


def executables_of(module: str, trees: Mapping[str, ast.Module]) -> set[str]:
    """Return the executables that run a module of nodes: itself, or those that derive their node from it."""
    if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in trees[module].body):
        return {module}
    return {
        stem
        for stem, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").endswith(f".nodes.{module}")
    }


def topics() -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Return publishers and subscribers of every topic whose name the sources give as a literal."""
    publishers: dict[str, set[str]] = defaultdict(set)
    subscribers: dict[str, set[str]] = defaultdict(set)
    trees = {file.stem: tree for _, file, tree in modules() if file.parent.name == "nodes"}
    for module, tree in trees.items():
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            literals = [a.value for a in call.args[1:2] if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            for topic in literals:
                if call.func.attr in PUBLISHING:
                    publishers[topic] |= executables_of(module, trees)
                if call.func.attr in SUBSCRIBING:
                    subscribers[topic] |= executables_of(module, trees)
    return publishers, subscribers


def node_diagram() -> str:
    """Return the nodes as a Mermaid diagram; an arrow is a topic from its publisher to its subscriber."""
    publishers, subscribers = topics()
    # Every node has these from its base; they would hide the rest.
    hidden = {"/diagnostics"}
    arrows: dict[tuple[str, str], set[str]] = defaultdict(set)
    for topic in sorted((set(publishers) & set(subscribers)) - hidden):
        for source in publishers[topic]:
            for target in subscribers[topic] - {source}:
                arrows[source, target].add(topic)
    lines = ["```mermaid", "flowchart LR"]
    lines += [f"    {source} -->|{', '.join(sorted(names))}| {target}" for (source, target), names in sorted(arrows.items())]
    return "\n".join([*lines, "```"])


def page_with(text: str, name: str, content: str) -> str:
    """Replace what stands between the markers of a section."""
    pattern = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- /{name} -->)", re.DOTALL)
    if not pattern.search(text):
        raise SystemExit(f"{PAGE}: has no section {name}, expected <!-- {name} --> and <!-- /{name} -->")
    return pattern.sub(lambda match: match[1] + content + match[2], text)


def main() -> None:
    """Write or check the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing, fail where the page is not up to date")
    arguments = parser.parse_args()
    old = PAGE.read_text(encoding="utf-8")
    new = page_with(page_with(old, "packages", package_diagram()), "nodes", node_diagram())
    if arguments.check and new != old:
        sys.exit(f"{PAGE}: is not up to date; run: python docs/tables/architecture.py")
    PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()

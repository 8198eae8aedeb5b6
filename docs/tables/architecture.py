"""Draws the diagram of docs/architecture.md from the sources: packages with their imports.

python docs/tables/architecture.py            # writes them into the page
python docs/tables/architecture.py --check    # fails where the page is not up to date
"""

import argparse
import ast
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

from sections import page_with

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"


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


def main() -> None:
    """Write or check the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing, fail where the page is not up to date")
    arguments = parser.parse_args()
    old = PAGE.read_text(encoding="utf-8")
    new = page_with(old, "packages", package_diagram(), PAGE)
    if arguments.check and new != old:
        sys.exit(f"{PAGE}: is not up to date; run: python docs/tables/architecture.py")
    PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()

"""The documentation as a site: it builds without a warning, its links lead somewhere, and it needs no network."""

import filecmp
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).resolve().parents[1]


def build(folder: Path) -> Path:
    options = ["--fail-on-warning", "--fresh-env", "--quiet"]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, "-c", ROOT / "docs/site", "-d", f"{folder}.doctrees", ROOT, folder],
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return build(tmp_path_factory.mktemp("site") / "first")


class Page(HTMLParser):
    """The targets of a page's links, what it loads, and its anchors."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attributes}
        self.anchors.add(found.get("id", ""))
        if "src" in found or (tag == "link" and "href" in found):
            self.loaded.add(found.get("src", found.get("href", "")))
        elif tag == "a" and "href" in found:
            self.links.add(found["href"])


def test_every_page_of_the_documentation_is_in_the_site(site):
    for page in [*ROOT.glob("docs/*.md"), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]:
        assert (site / page.relative_to(ROOT).with_suffix(".html")).exists()


def test_links_lead_somewhere_and_nothing_is_loaded_from_the_network(site):
    pages = {file: Page(file) for file in site.rglob("*.html")}
    assert len(pages) > 25
    for file, page in pages.items():
        for target in page.loaded | page.links:
            if re.match(r"(https?:|mailto:|data:|#$)", target):
                assert target in page.links, f"{file.name} loads {target}"
                continue
            path, _, anchor = unquote(target).partition("#")
            reached = (file.parent / path.partition("?")[0]).resolve() if path else file
            assert reached.exists(), f"{file.name}: {target}"
            if anchor and reached in pages:
                assert anchor in pages[reached].anchors, f"{file.name}: {target}"
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(\s*['\"]?https?:|@import", style.read_text(encoding="utf-8")), style


def test_diagrams_are_drawn_by_a_script_of_the_site(site):
    assert "mermaid-source" in (site / "docs/ros.html").read_text(encoding="utf-8")
    assert (site / "_static/mermaid/index.js").exists()


def test_the_same_sources_give_the_same_site(site, tmp_path):
    again = build(tmp_path / "again")
    files = [file.relative_to(site) for file in site.rglob("*") if file.is_file()]
    _, different, missing = filecmp.cmpfiles(site, again, files, shallow=False)
    assert [*map(str, different), *map(str, missing)] == []

"""The documentation as a site: the Markdown pages of this repository, as they are, by Sphinx. `make site` builds it.

Nothing is loaded from the network, neither by the build nor by a reader's browser.
"""

import re
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "src" / "mrd_base"))
from mrd_base.version import VERSION  # noqa: E402

project = "mrd-bench"
version = release = VERSION
language = "en"

extensions = ["myst_parser"]
root_doc = "docs/index"
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/*.md"]
myst_heading_anchors = 4
myst_fence_as_directive = ["mermaid"]
myst_enable_extensions = ["html_image"]

html_theme = "furo"
html_title = f"mrd-bench {VERSION}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("diagrams.js", {"type": "module"})]
html_extra_path = ["extra"]
html_copy_source = False
html_show_copyright = False


class Mermaid(Directive):
    """A diagram in Mermaid, which `static/diagrams.js` draws in the browser; where that cannot, its text is shown."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the text of the diagram in an element that the script finds."""
        return [nodes.literal_block("", "\n".join(self.content), language="text", classes=["mermaid-source"])]


def add_navigation(_app: Sphinx, page: str, source: list[str]) -> None:
    """Add to the front page what Sphinx needs for its list of pages: those that this page links, in its order."""
    if page == root_doc:
        pages = ["../README", *dict.fromkeys(re.findall(r"\]\(([\w./]+)\.md\)", source[0]))]
        source[0] += "\n".join(["\n```{toctree}", ":hidden:", *pages, "```\n"])


def add_mermaid(app: Sphinx, error: Exception | None) -> None:
    """Copy Mermaid into the site; it comes with NiceGUI, which the operator's page uses."""
    nicegui = find_spec("nicegui")
    if error is None and nicegui is not None and nicegui.submodule_search_locations:
        source = Path(nicegui.submodule_search_locations[0]) / "elements" / "mermaid" / "dist"
        shutil.copytree(source, Path(app.outdir) / "_static" / "mermaid", dirs_exist_ok=True)


def setup(app: Sphinx) -> None:
    """Add the directive, the list of pages, and Mermaid itself."""
    app.add_directive("mermaid", Mermaid)
    app.connect("source-read", add_navigation)
    app.connect("build-finished", add_mermaid)

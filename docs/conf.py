"""Settings of Sphinx: `docs/build_site` makes the documents a site that needs no network."""

import hashlib
import re
from pathlib import Path
from typing import Any

from vaoi_station.version import __version__

project = author = html_title = "vaoi_station"
release = __version__
extensions = ["myst_parser"]
include_patterns = ["README.md", "docs/**.md", "hw/**.md"]
exclude_patterns = ["**/build/**"]
root_doc = "docs/index"
html_theme = "furo"
html_static_path = html_css_files = ["site.css"]
html_show_sourcelink = html_copy_source = False
myst_heading_anchors = 4
# Headings begin below the first level in parts of pages; examples in JSON are cut with "…".
suppress_warnings = ["myst.header", "misc.highlighting_failure"]


def external_scripts(app: Any, exception: Exception | None) -> None:
    """Move scripts out of the pages into files: the station forbids browsers to run scripts that stand in a page."""
    if exception is not None:
        return
    static = Path(app.outdir, "_static")

    for page in Path(app.outdir).rglob("*.html"):
        first, *parts = re.split(r"<script>(.*?)</script>", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        up = "../" * (len(page.relative_to(app.outdir).parts) - 1)
        for script, after in zip(parts[::2], parts[1::2], strict=True):
            name = f"inline-{hashlib.sha256(script.encode()).hexdigest()[:16]}.js"
            (static / name).write_text(script, encoding="utf-8")
            first += f'<script src="{up}_static/{name}"></script>{after}'
        page.write_text(first, encoding="utf-8")


def setup(app: Any) -> None:
    """Register what follows a build."""
    app.connect("build-finished", external_scripts)

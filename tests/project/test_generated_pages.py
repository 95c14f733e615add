"""The generated pages of docs/reference are those that docs/generate.py writes."""

from __future__ import annotations

import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_generated_pages_are_up_to_date() -> None:
    pages = runpy.run_path(str(ROOT / "docs" / "generate.py"))["pages"]()
    outdated = [path.name for path, text in pages.items() if path.read_text(encoding="utf-8") != text]
    assert outdated == [], "run: python docs/generate.py"

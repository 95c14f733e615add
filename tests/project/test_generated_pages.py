"""The generated pages of docs/reference are those that docs/generate.py writes."""

from __future__ import annotations

import runpy
from pathlib import Path

from vaoi_station.settings.keys import keys

MADE = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "generate.py"))


def test_generated_pages_are_up_to_date() -> None:
    outdated = [path.name for path, text in MADE["pages"]().items() if path.read_text(encoding="utf-8") != text]
    assert outdated == [], "run: python docs/generate.py"


def test_every_key_of_a_file_has_a_meaning() -> None:
    found = [(title, key) for title, root in MADE["DOCUMENTS"].items() for key in keys(root)]
    assert [(t, key.key) for t, key in found if not key.description and key.key not in {"format", "version"}] == []

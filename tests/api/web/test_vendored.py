"""Vendored files equal the list in `VENDORED.md`."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

from vaoi_station.api.pages import WEB

LINE = re.compile(r"\| `(.+?)` \| `([0-9a-f]{64})` \|")


@pytest.mark.parametrize("vendor", [WEB / "vendor", Path(__file__).parent / "vendor"], ids=["page", "tests"])
def test_vendored_files_have_the_recorded_hashes(vendor: Path) -> None:
    written = dict(LINE.findall((vendor / "VENDORED.md").read_text()))
    found = {
        str(p.relative_to(vendor)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in vendor.rglob("*")
        if p.is_file() and p.name != "VENDORED.md"
    }
    assert found == written


def test_the_pages_name_no_other_host() -> None:
    for path in WEB.glob("*"):
        if path.is_file():
            assert not re.search(
                r"(https?:)?//[a-z0-9.-]+\.[a-z]", path.read_text().replace("http://www.w3.org", "")
            ), path

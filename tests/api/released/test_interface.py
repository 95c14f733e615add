"""docs/reference/changes.md lists every operation with its version; what was released stays as programs know it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.api.released.interface import interface_of
from vaoi_station.version import __version__

HERE = Path(__file__).parent
GUIDE = HERE.parents[2] / "docs" / "reference" / "changes.md"
RELEASES = sorted(path.stem for path in HERE.glob("*.json"))


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """The golden document, which is the one that the service has."""
    found: dict[str, Any] = json.loads((HERE.parent / "openapi.json").read_text(encoding="utf-8"))
    return found


def listed(heading: str) -> list[str]:
    """Return the operations below a heading of the page, as METHOD address."""
    text = GUIDE.read_text(encoding="utf-8").split(f"\n## {heading}\n", 1)[1]
    block = re.search(r"^```text\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert block is not None, heading
    lines = (line.split(" ") for line in block[1].splitlines())
    return [f"{method} {address}" for address, *methods in lines for method in methods]


def headings() -> list[str]:
    return re.findall(r"^## (.+)$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE)


def test_the_page_lists_every_operation_once_with_its_version(document: dict[str, Any]) -> None:
    versions = [heading for heading in headings() if heading not in ("Deprecated", "In words")]
    operations = [operation for version in versions for operation in listed(version)]
    assert sorted(operations) == sorted(interface_of(document)), "add a new operation under Unreleased"
    assert versions == ["Unreleased", *reversed(RELEASES)]
    assert RELEASES[-1] == __version__, "a release adds its interface to tests/api/released"


@pytest.mark.parametrize("release", RELEASES)
def test_what_was_released_stays(release: str, document: dict[str, Any]) -> None:
    """A program that was written for a release goes on with this version."""
    now, faults = interface_of(document), []
    for operation, before in json.loads((HERE / f"{release}.json").read_text(encoding="utf-8")).items():
        if operation not in now:
            faults.append(f"{operation} is absent")
            continue
        for part in ("parameters", "body", "answer"):
            faults += [f"{operation}: {part} {n} is absent" for n in before[part] if n not in now[operation][part]]
        faults += [
            f"{operation}: {n} is required now" for n in now[operation]["required"] if n not in before["required"]
        ]
    assert faults == []

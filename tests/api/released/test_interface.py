"""What was released stays as programs know it. docs/reference/addresses.md is made of the same files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.api.released.interface import interface_of
from vaoi_station.version import __version__

HERE = Path(__file__).parent
RELEASES = sorted(path.stem for path in HERE.glob("*.json"))


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """The golden document, which is the one that the service has."""
    found: dict[str, Any] = json.loads((HERE.parent / "openapi.json").read_text(encoding="utf-8"))
    return found


def test_the_latest_release_is_this_version() -> None:
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

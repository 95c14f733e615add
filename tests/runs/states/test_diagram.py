"""The tables of states in the documentation are those of the code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.runs.states.tables import RUN, STATION, Table

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "runs.md"


@pytest.mark.parametrize("table", [STATION, RUN], ids=lambda table: table.what)
def test_the_page_shows_the_tables_as_they_are(table: Table[Any, Any]) -> None:
    """On a failure, put the text that is expected here into the page."""
    arrows: dict[str, list[str]] = {}
    for (state, event), target in table.steps.items():
        arrows.setdefault(state, []).append(f"{event} → {target}")
    lines = [f"| state (first: {table.start}) | step → next state |", "|---|---|"]
    lines += [f"| {state} | {', '.join(steps)} |" for state, steps in arrows.items()]
    shown = re.search(rf"<!-- drawn: {table.what} -->\n(.*?)\n<!-- end -->", PAGE.read_text("utf-8"), re.DOTALL)
    assert shown is not None
    assert shown[1].splitlines() == lines

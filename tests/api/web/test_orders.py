"""The word and the order that the operator is shown, by the tables of docs/operator.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.tables import StationState

GUIDE = Path(__file__).parents[3] / "docs" / "operator.md"
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in GUIDE.read_text(encoding="utf-8").splitlines()]
STATES = [
    (row[2].strip("`"), code.strip("`–"), *row[:2])
    for row in ROWS
    if len(row) == 4 and row[2].startswith("`")
    for code in row[3].split(", ")
]
BOARDS = [
    (code.strip("`"), *row[:2])
    for row in ROWS
    if len(row) == 3 and row[2].startswith("`")
    for code in row[2].split(", ")
]


def provoke(station: Any, state: str, code: str) -> None:
    """Bring the held station into a state of the table."""
    reason = (Reason(code=code, message=f"Message of {code}.", action="Action."),) if code else ()
    station.lost = (1,) if state == "lacking" else ()
    held = state == "held" or code == "belt-stopped"
    station.held_back = reason if held else ()
    station.warnings = reason if code in ("board-id-uncertain", "no-calibration") else ()
    station.reasons = () if held or station.warnings else reason
    station.state = StationState.ARMED if state in ("lacking", "held") else StationState(state)
    station.publish("station", state=station.state)


@pytest.mark.browser
def test_every_state_shows_the_order_of_the_guide(page: Page, served: Any) -> None:
    assert {s for s, *_ in STATES} >= {s.value for s in StationState}
    assert len(STATES) >= 29, "one for each reason of a row"
    page.goto(served.url)
    for state, code, word, order in STATES:
        provoke(served.station, state, code)
        expect(page.locator("#state-word")).to_have_text(word)
        expect(page.locator("#order")).to_have_text(order)
        expect(page.locator("#why")).to_be_visible(visible=bool(code))
    assert page.evaluate("document.querySelector('.line').scrollHeight <= document.querySelector('main').clientHeight")


@pytest.mark.browser
def test_every_group_of_reasons_shows_the_order_of_the_guide(page: Page, served: Any) -> None:
    served.station.arm("demo-board")
    page.goto(served.url)
    assert len(BOARDS) > 10, "one for each reason of a row"
    for cause, word, order in BOARDS:
        run = served.station.film(finish=False, board_id="SN-47")
        verdict = Status.FAILED if word == "Board failed" else Status.DEGRADED
        code = "acquisition-lost" if cause == "acquisition-lost" else "stitch-degraded"
        served.station.finish(
            run, verdict, (Reason(code=code, message="Message.", cause="" if code == cause else cause),)
        )
        expect(page.locator("#order")).to_have_text(order)
        expect(page.locator("#state-word")).to_have_text(word)
        served.station.film(board_id="SN-47")
        expect(page.locator("#state-word")).to_have_text("Ready")
    # Frames that did not come explain what was not found in the rest.
    run = served.station.film(finish=False, board_id="SN-47")
    missing = Reason(code="frames-missing", message="The camera was lost.")
    not_found = Reason(code="stitch-failed", message="No fiducials.", cause="fiducials-not-found")
    served.station.finish(run, Status.FAILED, (not_found, missing))
    expect(page.locator("#order")).to_have_text("Board SN-47: no pictures. Take it out and film it again.")


@pytest.mark.browser
def test_both_languages_have_the_same_texts(page: Page, served: Any) -> None:
    """The meanings of settings, and what is translated by its code, have their English words from the station."""
    page.goto(served.url)
    english, german = page.evaluate("""async () => {
        const keys = (object, path) => Object.entries(object).flatMap(([key, value]) =>
            ["boardSides", "meanings", "translated"].includes(key) ? [] :
                typeof value === "object" ? keys(value, `${path}${key}.`) : [`${path}${key}: ${typeof value}`]);
        const modules = await Promise.all([import("/web/texts/en.js"), import("/web/texts/de.js")]);
        return modules.map((module) => keys(module.texts, "").sort());
    }""")
    assert english == german
    assert len(english) > 120

"""The word and the order that the operator is shown, by the tables of docs/operator.md."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.tables import StationState

GUIDE = Path(__file__).parents[3] / "docs" / "operator.md"
STATES = [
    tuple(cell.strip(" `") for cell in line.strip("|\n").split("|"))
    for line in GUIDE.read_text().splitlines()
    if re.match(r"\| `[a-z]+` \|", line)
]
BOARDS = [
    tuple(cell.strip(" `") for cell in line.strip("|\n").split("|"))
    for line in GUIDE.read_text().splitlines()
    if re.match(r"\| `[a-z-]+` \| (Check|Board)", line)
]
CLIPPED = """() => [...document.querySelectorAll("#view *")].filter((e) => {
    const style = getComputedStyle(e);
    return e.checkVisibility() && !e.closest("svg") && !["armed-with", "strip"].includes(e.id)
        && !["INPUT", "SELECT", "OPTION"].includes(e.tagName)
        && style.display !== "inline" && style.overflow !== "visible"
        && (e.scrollWidth > e.clientWidth + 1 || e.scrollHeight > e.clientHeight + 8);
}).map((e) => e.id || e.className)"""
"""The elements of the page whose contents do not fit."""


def provoke(station: Any, state: str, code: str) -> None:
    """Bring the held station into a state of the table."""
    reason = (Reason(code=code, message=f"Message of {code}.", action="Action."),) if code else ()
    station.lost = (1,) if state == "lacking" else ()
    held = state == "held" or code == "belt-stopped"
    station.held_back = reason if held else ()
    station.warnings = reason if code == "board-id-uncertain" else ()
    station.reasons = () if held or station.warnings else reason
    station.state = StationState.ARMED if state in ("lacking", "held") else StationState(state)
    station.publish("station", state=station.state)


def inside(part: Locator, frame: Locator) -> bool:
    """Return whether an element lies wholly in the frame that would clip it."""
    inner, outer = part.bounding_box(), frame.bounding_box()
    assert inner is not None
    assert outer is not None
    return outer["y"] <= inner["y"] and inner["y"] + inner["height"] <= outer["y"] + outer["height"]


@pytest.mark.browser
def test_every_state_shows_the_order_of_the_guide(page: Page, served: Any) -> None:
    assert {s for s, *_ in STATES} >= {s.value for s in StationState}
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
            ["meanings", "translated"].includes(key) ? [] :
                typeof value === "object" ? keys(value, `${path}${key}.`) : [`${path}${key}: ${typeof value}`]);
        const modules = await Promise.all([import("/web/texts/en.js"), import("/web/texts/de.js")]);
        return modules.map((module) => keys(module.texts, "").sort());
    }""")
    assert english == german
    assert len(english) > 120


@pytest.mark.browser
def test_frames_that_did_not_come_prove_no_trigger(page: Page, served: Any) -> None:
    page.goto(served.url)
    said = page.evaluate("""async () => {
        const { texts } = await import("/web/texts/en.js");
        const proof = (proven) => ({ proven, cameras: [{ camera: 1, proven }] });
        return [texts.trigger(proof(true), ""), texts.trigger(proof(false), ""), texts.trigger(proof(true), "3.3")];
    }""")
    assert said == [
        "no frame to confirm",
        "not confirmed for camera 1",
        "all frames match their pulses within 3.3 µs",
    ]


COVERED = """() => {
    const place = (id) => document.getElementById(id).getBoundingClientRect();
    const [word, actions] = [place("verdict-word"), place("actions")];
    return word.height > 0 && actions.height > 0 && word.bottom > actions.top + 1;
}"""
"""Whether the buttons cover the verdict; both places are of one moment."""


@pytest.mark.browser
@pytest.mark.parametrize(("width", "height", "letters"), [(800, 480, 36), (1280, 800, 56)])
@pytest.mark.parametrize("language", ["en", "de"])
def test_word_and_order_are_large_and_nothing_is_clipped(
    browser: Browser, served: Any, width: int, height: int, letters: int, language: str
) -> None:
    """At 1280 × 800, a letter of 56 px has 16 minutes of arc at 2 m on a panel of 10 inches."""
    context = browser.new_context(viewport={"width": width, "height": height}, locale=language, color_scheme="dark")
    page = context.new_page()
    served.station.film(verdict=Status.FAILED, board_id="SN-47-of-a-long-series")
    page.goto(served.url)
    for n, (state, code, *_) in enumerate([*STATES, ("idle", "", "")]):
        if n == len(STATES):
            served.station.film(verdict=Status.DEGRADED, board_id="SN-48")
        provoke(served.station, state, code)
        expect(page.locator("#state-shape")).to_have_attribute("data-state", state)
        clipped = page.evaluate(CLIPPED)
        assert clipped == [], (state, code)
        box = page.locator("#arm").bounding_box()
        assert box is not None
        assert box["y"] + box["height"] <= height
        assert page.evaluate(COVERED) is False, "the buttons do not cover the verdict"
    served.station.lost = (1,)
    page.locator("#arm").click()
    expect(page.locator("#answer summary")).to_be_visible()
    assert page.evaluate(CLIPPED) == []
    box = page.locator("#answer").bounding_box()
    assert box is not None
    assert box["y"] + box["height"] <= height
    served.station.lost = ()
    provoke(served.station, "arming", "")
    expect(page.locator("#answer")).to_be_empty()
    provoke(served.station, "idle", "")
    # A board without pictures keeps its place, with its buttons, while later boards are good; then its form.
    served.station.film()
    expect(page.locator("#last")).to_have_class("other-board")
    assert page.evaluate(CLIPPED) == []
    buttons = page.locator("#decisions button")
    for n in range(2):
        assert inside(buttons.nth(n), page.locator("#last"))
    assert inside(page.locator("#open-board"), page.locator("#last"))
    buttons.first.click()
    assert page.evaluate(CLIPPED) == []
    for button in buttons.all():
        assert inside(button, page.locator("#last"))
    size = "e => 0.7 * parseFloat(getComputedStyle(e).fontSize)"  # the height of capitals
    order, word = (page.locator(name).evaluate(size) for name in ("#order", "#state-word"))
    assert order >= letters
    assert word >= (75 if width >= 1280 else letters)
    context.close()

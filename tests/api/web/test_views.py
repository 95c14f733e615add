"""Every view at every size, in both languages, light and dark: nothing is clipped, axe finds nothing, memory stays."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest
from playwright.sync_api import Browser, Page, expect
from playwright.sync_api import TimeoutError as SlowPage

from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.tables import StationState

pytestmark = pytest.mark.browser
AXE = Path(__file__).parent / "vendor" / "axe-core" / "axe.min.js"
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
SIZES = ((390, 844), (800, 480), (1024, 768), (1280, 800), (1920, 1080))
VIEWS = {
    "/": "#verdict-word:not(:empty)",
    "/#/boards": "#list tbody tr",
    "/#/board/r000001": 'button img[alt*="amera"]',
    "/#/board/r000002": "#raw td img",
    "/#/trends": ".trends[data-shown]",
    "/#/cameras": ".cameras[data-shown]",
    "/#/setup": "#view h2",
}
"""Every view, and what it has once it is complete."""
WIDE = """() => {
    const beyond = (e) => e.scrollWidth > e.clientWidth + 1;
    const frame = ["html", "main", "nav"].map((name) => document.querySelector(name));
    const scrolled = frame.filter(beyond);
    const clipped = [...document.querySelectorAll("main *")].filter((e) => {
        const style = getComputedStyle(e);
        const hides = ["hidden", "clip"].includes(style.overflowX) && style.textOverflow !== "ellipsis";
        return e.checkVisibility() && hides && beyond(e) && !e.closest("svg, .chart-area, #zoom-view");
    });
    return [...scrolled, ...clipped].map((e) => e.id || e.className || e.tagName);
}"""
"""The elements whose contents are wider than they are: pages scroll downwards only."""


CONTROLS = """[...document.querySelectorAll(
    "main :is(a[href], button, input, select, textarea, summary, [tabindex='0'])"
)].filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0)"""
HEADER_CONTROLS = 12
"""More than the entries of the navigation, which come first."""
WATCH_FOCUS = """() => {
    window.reached = new Set();
    document.addEventListener("focusin", ({ target }) => reached.add(target));
    document.activeElement.blur();
}"""


def wide_elements(page: Page) -> Any:
    """Return what stays wide. The viewer of the board takes the size of its view a few pictures later."""
    try:
        page.wait_for_function(f"() => !({WIDE})().length", timeout=3000)
    except SlowPage:
        return page.evaluate(WIDE)
    return []


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_view_fits_and_everyone_can_use_it(browser: Browser, served: Any, language: str) -> None:
    served.station.kept.trends.fill(150)
    served.station.film(board_id="SN-47-of-a-long-series")
    served.station.film(verdict=Status.FAILED, board_id="SN-48-of-a-long-series")
    served.station.film(verdict=Status.DEGRADED, board_id="SN-49")
    context = browser.new_context(locale=language, has_touch=True)
    page = context.new_page()
    found: dict[str, Any] = {}

    def check(name: str) -> None:
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            if wide := wide_elements(page):
                found[f"{name} at {width} × {height}"] = wide
        # The texts of the other language are as long, but their elements the same.
        if language == "en":
            for scheme in SCHEMES:
                page.emulate_media(color_scheme=scheme)
                if violations := examine(page):
                    found[f"{name} {scheme}"] = violations
            if missing := unreached(page):
                found[f"{name} by keyboard"] = missing

    for path, complete in VIEWS.items():
        page.goto(served.url + path)
        page.locator(complete).first.wait_for()
        check(path)
    page.goto(served.url)
    for name, look in line_looks(page, served).items():
        look()
        check(name)
    context.close()
    assert found == {}


def line_looks(page: Page, served: Any) -> dict[str, Callable[[], None]]:
    """Return how the operator's view comes to look otherwise than at rest, in this order."""
    station = served.station
    shown = page.locator("#state-shape")

    def decide() -> None:
        page.locator("#decisions button").first.click()
        expect(page.locator("#decision-name")).to_be_visible()

    def fault() -> None:
        page.locator("#decision [type=button]").last.click()
        station.fault("camera-absent", "Camera 2 does not answer.", "Check its cable.")
        expect(shown).to_have_attribute("data-state", "faulted")
        page.locator("#why").click()

    def hold() -> None:
        page.locator("#close-details").click()
        station.reasons, station.state = (), StationState.ARMED
        station.held_back = (Reason(code="devices-silent", message="No report for 2 s."),)
        station.publish("station", state="armed")
        expect(shown).to_have_attribute("data-state", "held")

    def lose() -> None:
        served.stop()
        expect(page.locator("body")).to_have_class(re.compile("stale"))

    return {"decision": decide, "fault": fault, "held": hold, "stale": lose}


def examine(page: Page) -> list[str]:
    """Return what axe finds on the page that is open, with the elements."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text(encoding="utf-8"))
    violations = page.evaluate("axe.run().then((found) => found.violations)")
    return [f"{v['id']}: {v['help']}: {[node['target'] for node in v['nodes'][:3]]}" for v in violations]


def unreached(page: Page) -> list[str]:
    """Go through the whole page by the tabulator; return the controls in sight that it does not reach."""
    page.evaluate(WATCH_FOCUS)
    for _ in range(page.evaluate(f"{CONTROLS}.length") + HEADER_CONTROLS):
        page.keyboard.press("Tab")
    names: list[str] = page.evaluate(f"{CONTROLS}.filter((e) => !reached.has(e)).map((e) => e.outerHTML.slice(0, 120))")
    return names


def test_boards_back_to_back_leave_no_memory_behind(page: Page, served: Any) -> None:
    """Elements and listeners are counted after a forced garbage collection; a page that keeps boards has more."""
    served.station.arm("demo-board")
    page.goto(served.url)
    client = page.context.new_cdp_session(page)

    def boards(count: int) -> dict[str, int]:
        for _ in range(count):
            run = served.station.film()
        expect(page.locator("#strip a").last).to_have_attribute("href", f"#/board/{run}")
        expect(page.locator("#last-picture .board-picture")).to_be_visible()
        client.send("HeapProfiler.collectGarbage")
        counters: dict[str, int] = client.send("Memory.getDOMCounters")
        return counters | {"heap": int(client.send("Runtime.getHeapUsage")["usedSize"])}

    before = boards(25)
    after = boards(40)
    assert after["nodes"] <= before["nodes"] + 50
    assert after["jsEventListeners"] <= before["jsEventListeners"] + 10
    assert after["heap"] <= before["heap"] + 500_000, "12 kB per board"

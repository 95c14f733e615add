"""Every view at every size, in both languages, light and dark: nothing is clipped, axe finds nothing, memory stays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from vaoi_station.model import Status

pytestmark = pytest.mark.browser
AXE = Path(__file__).parent / "vendor" / "axe-core" / "axe.min.js"
SIZES = ((800, 480), (1024, 768), (1280, 800), (1920, 1080))
VIEWS = {
    "/": "#verdict-word:not(:empty)",
    "/#/boards": "#list tbody tr",
    "/#/board/r000001": "#board-title:not(:empty)",
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


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_view_fits_and_everyone_can_use_it(browser: Browser, served: Any, language: str) -> None:
    served.station.kept.trends.fill(150)
    served.station.film(board_id="SN-47-of-a-long-series")
    served.station.film(verdict=Status.DEGRADED, board_id="SN-48")
    context = browser.new_context(locale=language, has_touch=True)
    page = context.new_page()
    found: dict[str, Any] = {}
    for path, complete in VIEWS.items():
        page.goto(served.url + path)
        page.locator(complete).first.wait_for()
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            if wide := page.evaluate(WIDE):
                found[f"{path} at {width} × {height}"] = wide
        # The texts of the other language are as long, but their elements the same.
        for scheme in ("light", "dark") if language == "en" else ():
            page.emulate_media(color_scheme=scheme)
            if violations := examine(page):
                found[f"{path} {scheme}"] = violations
    context.close()
    assert found == {}


def examine(page: Page) -> list[str]:
    """Return what axe finds on the page that is open, with the elements."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text(encoding="utf-8"))
    violations = page.evaluate("axe.run().then((found) => found.violations)")
    return [f"{v['id']}: {v['help']}: {[node['target'] for node in v['nodes'][:3]]}" for v in violations]


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

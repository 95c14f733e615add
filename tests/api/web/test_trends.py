"""Trends in a real browser: charts, what changed, the comparison of two spans, by keyboard alone."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser
PICTURES = os.environ.get("VAOI_PICTURES")
"""Directory into which the pictures of the guide are written, if it is named (docs/pictures)."""


CHART = """async (lines) => {
    const { Chart } = await import("/web/trends/chart.js");
    const series = Array.from({ length: lines }, (_, n) => ({
        part: `${n}`, upper: 5, values: [n, n], least: [n, n], largest: [n, n === 1 ? 9 : n], runs: [`a${n}`, `b${n}`],
    }));
    const times = ["2026-01-01T00:00:00Z", "2026-01-01T01:00:00Z"];
    const chart = new Chart("seam_px");
    document.querySelector("body > .chart")?.remove();
    document.body.prepend(chart.root);
    await chart.show({ times, since: times[0], until: "2026-01-01T02:00:00Z", marks: [], bin_s: 3600 }, series);
}"""
"""Draws a chart of bins with level lines at 0, 1, …; line 1 has a largest value of 9 in the second bin."""


def test_trends_say_what_changed_and_a_point_opens_its_board(page: Page, served: Any) -> None:
    served.station.kept.trends.fill(150)
    for n in range(3):
        served.station.film(board_id=f"SN-{n}")
    page.goto(f"{served.url}/#/trends")
    expect(page.locator(".chart canvas")).to_have_count(10)
    expect(page.locator("#trend-answer")).to_have_text(re.compile("^1(19|20) boards, each point is a board"))
    expect(page.locator("#chart-seam_px .chart-parts li")).to_have_text(["0-1", "1-2"])
    expect(page.locator("#chart-brightness_percent .chart-warning")).to_have_text("⚠ 8 points beyond the limit")
    expect(page.locator("#marks li")).to_contain_text("Calibration: c0ffee00 → ca11b4a7")
    # The spans before and since the mark: the seam is what became worse.
    mark = page.locator("#compare-choice option", has_text="since").get_attribute("value")
    page.locator("#compare-choice").select_option(mark)
    expect(page.locator("#changes li").first).to_contain_text("Seams between cameras 0-1")
    expect(page.locator("#changes li").first).to_contain_text("worse")
    page.reload()
    expect(page.locator("#changes li").first).to_contain_text("worse")
    expect(page.locator("#compare-choice")).to_have_value(mark or "")
    if PICTURES:
        page.screenshot(path=Path(PICTURES) / "page-trends.png")
    page.locator("#changes a").first.press("Enter")
    area = page.locator("#chart-seam_px .chart-area")
    expect(area).to_be_focused()
    page.keyboard.press("End")
    before = area.get_attribute("aria-valuetext")
    page.keyboard.press("ArrowLeft")
    expect(area).not_to_have_attribute("aria-valuetext", before or "")
    page.keyboard.press("Home")
    expect(area).to_have_attribute("aria-valuenow", "0")
    page.keyboard.press("End")
    page.evaluate("document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'Enter' }))")
    expect(page.locator("#board-title")).to_have_text("There is no such board.")  # it is of the figures alone
    assert page.url.endswith("#/board/r000150")


def test_a_link_reproduces_span_type_and_bins(page: Page, served: Any) -> None:
    served.station.kept.trends.fill(900)
    page.goto(f"{served.url}/#/trends?span=week&board_type=demo-board")
    expect(page.locator("#trend-answer")).to_contain_text("each point: 30 minutes, mean with least and largest")
    page.get_by_label("Span").select_option("month")
    expect(page.locator("#trend-answer")).to_contain_text("each point: 2 hours")
    page.reload()
    expect(page.get_by_label("Span")).to_have_value("month")
    expect(page.get_by_label("Board type")).to_have_value("demo-board")
    expect(page.locator("#chart-ready_ms .chart-readout")).to_contain_text(re.compile(r"\d+ \(\d+ to \d+\)"))
    page.goto(f"{served.url}/#/trends?board_type=other")
    expect(page.locator("#trend-answer")).to_contain_text("No boards in this span.")
    expect(page.locator("#compare-answer")).to_contain_text("Too few boards")


def test_a_point_of_bins_opens_the_board_of_the_line_next_to_it(page: Page, served: Any) -> None:
    """With more than three lines they are drawn without the bands of least and largest values."""
    page.goto(served.url)
    for lines, height, run in ((3, 0.1, "b1"), (3, 0.95, "b0"), (5, 0.1, "b4")):
        page.evaluate(CHART, lines)
        area = page.locator("body > .chart .u-over")
        area.scroll_into_view_if_needed()
        box = area.bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + height * box["height"])
        expect(page).to_have_url(f"{served.url}/#/board/{run}")

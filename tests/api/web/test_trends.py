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
    expect(page.locator(".chart").first).to_have_id("chart-seam_px")  # the figure that moved most
    expect(page.locator(".time-axis canvas")).to_be_visible()
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
    expect(page.locator("#chart-sigma_px .chart-area")).to_have_attribute("aria-valuenow", "0")  # one cursor for all
    page.keyboard.press("End")
    page.evaluate("document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'Enter' }))")
    expect(page.locator("#board-title")).to_have_text("There is no such board.")  # it is of the figures alone
    assert page.url.endswith("#/board/r000150")

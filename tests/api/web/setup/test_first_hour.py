"""The engineer's first hour, as docs/tutorials/first-hour.md has it."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import pytest
from playwright.sync_api import Page, expect

from tests.api.held.setup_files import film_board
from tests.api.web.setup.test_types import choose_file
from tests.board_data.readers import samples
from vaoi_station.api.routes.doctor import Examination, Examinations
from vaoi_station.files.calibrations import Layout
from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.run_ids import utc

pytestmark = pytest.mark.browser
GUIDE = Path(__file__).parents[4] / "docs" / "tutorials" / "first-hour.md"
STEPS = re.findall(r"^\| \d+ \| .+ \| (.+) \|$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE)
REPORT = {
    "created": "2026-01-01T00:00:00Z",
    "worst": "warning",
    "findings": [
        {"check": "cameras", "subject": "cam1", "level": "warning", "message": "Blurred.", "action": "Wipe the lens."}
    ],
}


class Hour:
    """What the engineer does on the page in each step of the guide, and what happens at the line."""

    def __init__(self, page: Page, station: Any, url: str) -> None:
        self.page, self.station, self.url = page, station, url

    def step_1(self) -> None:
        self.page.goto(self.url)
        self.enter("Set up")
        choose_file(self.page, "#board-file", "board.kicad_pcb", samples.KICAD)

    def step_2(self) -> None:
        self.page.get_by_label("Name of the board type").fill("product-7")
        self.page.keyboard.press("Tab")
        self.press("Store as product-7")

    def step_3(self) -> None:
        self.page.get_by_label("Revision of the data").fill("B")
        self.press("Keep the revision")

    def step_4(self) -> None:
        self.page.get_by_role("link", name="Calibration").click()
        expect(self.page.locator("img.artwork")).not_to_have_js_property("naturalWidth", 0)
        layout = self.page.evaluate("() => fetch('/api/v1/calibration/layout').then((r) => r.json())")
        self.run = film_board(self.station, Layout.model_validate(layout))
        expect(self.page.get_by_label("Run")).to_have_value(self.run)
        self.page.get_by_label("Row in which").fill("0")

    def step_5(self) -> None:
        self.press("Calibrate")
        expect(self.page.get_by_role("heading", name="4. Judge it")).to_be_visible(timeout=100_000)

    def step_6(self) -> None:
        self.press("Accept it")

    def step_7(self) -> None:
        run = self.station.film(finish=False, board_id="SN-8")
        message = "The overlap of cameras 0 and 1 is saturated."
        reason = Reason(code="stitch-degraded", cause="overlap-exposure", message=message, action="Correct the light.")
        self.station.finish(run, Status.DEGRADED, (reason,))
        yesterday = utc(datetime.now(UTC) - timedelta(days=1))
        self.station.filmed[run] = self.station.filmed[run].model_copy(update={"started": yesterday})
        self.enter("Boards")
        self.page.get_by_label("Span").select_option("yesterday")
        self.page.get_by_label("Verdict").select_option("degraded")
        self.press("Show")
        expect(self.page.locator("#list tbody tr")).to_have_count(1)

    def step_8(self) -> None:
        self.page.locator("#list tbody a").click()
        self.page.get_by_role("tab", name="Report").click()

    def step_9(self) -> None:
        self.enter("Trends")
        mark = self.page.locator("#compare-choice option", has_text="since").get_attribute("value")
        self.page.locator("#compare-choice").select_option(mark)

    def step_10(self) -> None:
        self.enter("Cameras")
        self.press("Examine the station")

    def enter(self, name: str) -> None:
        self.page.get_by_role("navigation").get_by_role("link", name=name, exact=True).click()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()


def test_the_first_hour_is_that_of_the_guide(
    page: Page, engineer: Any, admin: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Examinations, "examine", AsyncMock(return_value=Examination.model_validate(REPORT)))
    engineer.station.kept.trends.fill(150)
    hour = Hour(page, engineer.station, admin)
    assert len(STEPS) == len([name for name in vars(Hour) if name.startswith("step_")])
    for n, shows in enumerate(STEPS, start=1):
        getattr(hour, f"step_{n}")()
        for text in re.findall(r"\*\*(.+?)\*\*", shows):
            expect(page.locator("#view")).to_contain_text(text)

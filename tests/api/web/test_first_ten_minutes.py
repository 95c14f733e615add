"""The operator's first ten minutes, as docs/operator.md has them, on a panel of 800 × 480."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.tables import StationState

pytestmark = pytest.mark.browser
GUIDE = Path(__file__).parents[3] / "docs" / "operator.md"
STEPS = re.findall(r"^\| \d+ \| (.+) \| (.+) \| (.+) \|$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE)
PICTURES = os.environ.get("VAOI_PICTURES")
"""Directory into which the pictures of the guide are written, if it is named (docs/pictures)."""


class Shift:
    """What happens at the line in each step of the guide, and what the operator does on the page."""

    def __init__(self, page: Page, station: Any, serve: Callable[..., Any]) -> None:
        self.page, self.station, self.serve = page, station, serve
        self.server = serve(station)

    def step_1(self) -> None:
        self.page.goto(self.server.url)

    def step_2(self) -> None:
        self.page.get_by_label("Type").select_option("demo-board")
        self.page.get_by_role("button", name="Arm", exact=True).click()
        expect(self.page.get_by_role("button", name="Disarm: hold")).to_be_visible()

    def step_3(self) -> None:
        self.become(StationState.FILMING)

    def step_4(self) -> None:
        self.station.state = StationState.ARMED
        self.station.film(board_id="SN-46")
        expect(self.page.locator("#last")).to_contain_text("Pictures good")

    def step_5(self) -> None:
        run = self.station.film(finish=False, board_id="SN-47")
        lost = Reason(code="frames-missing", message="The frames of camera 1 did not arrive.", action="Check it.")
        self.station.finish(run, Status.FAILED, (lost,))
        expect(self.page.get_by_role("button", name="Film again")).to_be_in_viewport(ratio=1)

    def step_6(self) -> None:
        self.page.get_by_role("button", name="Film again").click()
        self.page.get_by_label("Your name").fill("Ada")
        expect(self.page.get_by_label("Reason")).to_have_value("frames-missing")
        self.page.get_by_role("button", name="Film again").click()

    def step_7(self) -> None:
        self.station.lose(2)
        expect(self.page.locator("#lost")).to_contain_text("Camera cam2 (10.1.0.2, switch A) does not answer")
        self.page.get_by_role("button", name="Why?").click()
        expect(self.page.locator("#reasons")).to_contain_text("Camera cam2 is not connected.")
        self.page.get_by_role("button", name="Close").click()

    def step_8(self) -> None:
        self.station.lose()

    def step_9(self) -> None:
        self.station.reasons = (Reason(code="ring-full", message="All runs are held.", action="Release one."),)
        self.become(StationState.BLOCKED)

    def step_10(self) -> None:
        self.station.reasons = ()
        self.become(StationState.ARMED)

    def step_11(self) -> None:
        self.server.stop()

    def step_12(self) -> None:
        self.station.closed = False
        self.station.state = StationState.STARTING
        self.server = self.serve(self.station, self.server.port)

    def step_13(self) -> None:
        self.become(StationState.ARMED)

    def step_14(self) -> None:
        self.page.get_by_role("button", name="Disarm: hold").click(delay=1500)

    def become(self, state: StationState) -> None:
        """Bring the station into a state."""
        self.station.state = state
        self.station.publish("station", state=str(state))


def test_the_first_ten_minutes_are_those_of_the_guide(page: Page, station: Any, serve: Callable[..., Any]) -> None:
    page.set_viewport_size({"width": 800, "height": 480})
    shift = Shift(page, station, serve)
    assert len(STEPS) == len([name for name in vars(Shift) if name.startswith("step_")])
    for n, (_, word, order) in enumerate(STEPS, start=1):
        getattr(shift, f"step_{n}")()
        expect(page.locator("#state-word")).to_have_text(word)
        expect(page.locator("#order")).to_have_text(order)
        picture = {5: "failed", 7: "camera-missing"}.get(n)
        if PICTURES and picture:
            page.screenshot(path=Path(PICTURES) / "operator" / f"{picture}.png")
    shift.server.stop()

"""Cards of cameras in a real browser: newest frame, sharpness, histogram, state, drift, findings of the doctor."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import pytest
from playwright.sync_api import Page, expect

from vaoi_station.api.cameras.examination import Examinations
from vaoi_station.api.cameras.models import Examination

pytestmark = pytest.mark.browser
PICTURES = os.environ.get("VAOI_PICTURES")
FINDING = {
    "check": "cameras",
    "subject": "cam2",
    "level": "warning",
    "message": "12 packets lost.",
    "action": "Change the cable.",
}


def test_each_camera_has_a_card_that_follows_its_frames(
    page: Page, served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = {
        "created": "2026-01-01T00:00:00Z",
        "worst": "warning",
        "findings": [FINDING, FINDING | {"level": "ok", "action": ""}],
    }
    monkeypatch.setattr(Examinations, "examine", AsyncMock(return_value=Examination.model_validate(report)))
    page.goto(f"{served.url}/#/cameras")
    cards = page.locator(".camera-card")
    expect(cards).to_have_count(3)
    expect(cards.nth(0).locator(".camera-picture")).to_have_text("No frame in memory. Let a board pass.")
    served.station.film(board_id="SN-1")
    for card in cards.all():
        expect(card.locator("img")).not_to_have_js_property("naturalWidth", 0)
        expect(card.locator(".sharpness-words span")).to_have_count(9)
        expect(card.locator(".camera-focus b")).to_have_text(re.compile(r"0\.\d\d"))
        expect(card.locator(".histogram rect")).to_have_count(64)
        expect(card.locator("dl")).to_contain_text("Mbit/s")
    expect(cards.nth(1).locator("dl")).to_contain_text("moved by 9.40 px")
    served.station.lose(2)
    expect(cards.nth(2).locator(".camera-state")).to_have_text("not connected")
    page.get_by_role("button", name="Examine the station").press("Enter")
    expect(page.locator("#doctor-answer")).to_contain_text("1 of 2 findings need attention.")
    expect(page.locator("#doctor-findings li")).to_have_text(re.compile("Warning: cameras, cam2.*Change the cable."))
    expect(cards.nth(2).locator(".camera-remarks")).to_contain_text("12 packets lost. Change the cable.")
    if PICTURES:
        page.screenshot(path=Path(PICTURES) / "page-cameras.png")

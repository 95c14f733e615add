"""Light programs in a real browser: rows are edited by the keyboard, checked with every change, and stored."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

FOUND_NOTHING = re.compile("The station can film with this program|Nothing was found against")
pytestmark = pytest.mark.browser
PROGRAM = ({"light": "even", "exposure_us": (400.0,)}, {"light": "left", "on_us": 60.0, "exposure_us": (100.0,)})


def test_a_program_is_edited_checked_and_stored(page: Page, engineer: Any, fits: Any) -> None:
    station = engineer.station
    page.goto(f"{engineer.url}/#/setup/programs")
    expect(page.get_by_text("This board type has no program, and neither has the station.")).to_be_visible()
    expect(page.locator("#no-program tbody tr")).to_have_text(["0even2002500", "1left1202500"])
    expect(page.locator(".answer.done")).to_be_hidden()
    expect(page.get_by_role("button", name="Store the program")).to_be_hidden()
    page.get_by_role("button", name="Begin a program").press("Enter")
    expect(page.get_by_label("Light, row 0")).to_be_focused()
    expect(page.locator("#steps tbody tr")).to_have_count(2)
    expect(page.get_by_text("What you enter is not stored yet.")).to_be_visible()
    expect(page.get_by_label("Exposure, µs, row 1")).to_have_attribute("placeholder", "250")
    page.get_by_label("Exposure, µs, row 0").fill("400")
    page.get_by_label("Exposure, µs, row 1").fill("9000")
    page.get_by_label("On-time, µs, row 1").fill("8000")
    expect(page.get_by_text("The station refuses this program for 4 reasons:")).to_be_visible()
    expect(page.locator(".finding")).to_contain_text("on_us is 8000.0, but must be at most 3750.0 for camera cam2")
    expect(page.locator(".finding")).to_contain_text(
        "must be 50 … 500 (the longest pulse of channel 2 in its firmware)"
    )
    expect(page.get_by_label("On-time, µs, row 1")).to_have_attribute("aria-invalid", "true")
    expect(page.locator(".program-timeline .wrong")).to_have_count(1)
    expect(page.locator(".program-timeline .limit")).not_to_have_count(0)
    page.get_by_role("button", name="Store the program").click()
    assert station.types["demo-board"].program is None, "what arming would refuse is not stored"
    page.get_by_label("On-time, µs, row 1").fill("many")
    expect(page.get_by_text("“many” is not a number.")).to_be_visible()
    page.get_by_label("On-time, µs, row 1").fill("60")
    page.get_by_label("Exposure, µs, row 1").fill("100")
    expect(page.get_by_text(FOUND_NOTHING)).to_be_visible()
    expect(page.locator(".program-timeline .wrong")).to_have_count(0)
    page.get_by_role("button", name="Store the program").press("Enter")
    expect(page.locator(".answer.done").last).to_have_text("Stored. It applies from the next arming on.")
    stored = station.board_type("demo-board").program
    assert stored is not None
    assert tuple(step.model_dump(exclude_none=True) for step in stored) == PROGRAM
    fits("programs", ".program-timeline")


def test_faults_are_in_german_on_a_german_page(page: Page, engineer: Any) -> None:
    known = engineer.station.types["demo-board"]
    steps = [{"light": "left", "on_us": 8000.0, "exposure_us": [9000.0]}, {"light": "left", "exposure_us": [100.0]}]
    wrong = {"program": steps}
    engineer.station.types["demo-board"] = known.model_validate({**known.model_dump(), **wrong})
    page.goto(engineer.url)
    page.evaluate("localStorage.setItem('vaoi-language', 'de')")
    page.goto(f"{engineer.url}/#/setup/programs")
    page.reload()
    finding = page.locator(".finding")
    expect(finding).to_contain_text("Licht left: 8000 µs Leuchtdauer; die Steuerung erlaubt 50 … 500 µs.")
    expect(finding).to_contain_text("Kamera cam2: 8000 µs Licht sind zu lang; in mehr als 3750.0 µs")
    expect(finding).to_contain_text("Ob Kamera cam0, Kamera cam1, Kamera cam2 so lange")
    expect(finding.locator("[lang=en]").first).to_be_hidden()
    page.get_by_text("Einzelheiten (englisch)").first.click()
    expect(finding.locator("[lang=en]").first).to_contain_text("must be at most 3750.0 for camera cam0")

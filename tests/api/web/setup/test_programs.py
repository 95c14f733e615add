"""Light programs in a real browser: rows are edited by the keyboard, checked with every change, and stored."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.api.held.programs import healthy, station_config
from vaoi_station.runs.lighting.programs import LightPrograms

FOUND_NOTHING = re.compile("The station can film with this program|Nothing was found against")
pytestmark = pytest.mark.browser
PICTURES = os.environ.get("VAOI_PICTURES")
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
    if PICTURES:
        page.set_viewport_size({"width": 1280, "height": 1500})
        page.screenshot(path=Path(PICTURES) / "lights" / "program.png")
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


def test_without_lights_the_page_says_that_all_rows_are_filmed_alike(page: Page, engineer: Any) -> None:
    dark = station_config(3, controller={"backend": "serial", "lights": {}})
    engineer.station.lighting.programs = LightPrograms(dark, (8.0,) * 3, lambda: healthy(3))
    page.goto(f"{engineer.url}/#/setup/programs")
    expect(page.get_by_text("The station states no lights: every row is filmed alike")).to_be_visible()
    expect(page.locator("#steps")).to_be_hidden()
    page.get_by_role("button", name="Begin a program").click()
    expect(page.get_by_label("Light, row 0")).to_be_focused()


def test_rows_are_moved_by_the_keyboard_and_cameras_have_values_of_their_own(page: Page, engineer: Any) -> None:
    station = engineer.station
    known = station.types["demo-board"]
    station.types["demo-board"] = known.model_validate({**known.model_dump(), "program": PROGRAM})
    page.goto(f"{engineer.url}/#/setup/programs/demo-board?light=left&on_us=70&camera=1&exposure_us=90&gain_db=0")
    expect(page.get_by_text("The settings of the camera are added as the last row.")).to_be_visible()
    expect(page.locator("#steps tbody tr")).to_have_count(3)
    page.get_by_role("button", name="Move row 2 up").press("Enter")
    expect(page.get_by_label("Light, row 1")).to_be_focused()
    expect(page.get_by_label("On-time, µs, row 1")).to_have_value("70")
    own = [page.get_by_label(f"Exposure, µs, row 1, cam{n}") for n in range(3)]
    expect(own[0]).to_have_value("250")  # what the other cameras have
    expect(own[1]).to_have_value("90")
    page.get_by_role("button", name="Delete row 1").press("Enter")
    page.get_by_role("button", name="Delete row 0").press("Enter")
    page.get_by_role("button", name="Copy row 0").press("Enter")
    own[0].fill("110")
    own[1].fill("120")
    expect(page.locator(".finding")).to_contain_text("must be 110 µs as for camera cam0: the width of one trigger")
    expect(own[1]).to_have_attribute("aria-invalid", "true")
    expect(own[0]).not_to_have_attribute("aria-invalid", "true")
    own[0].fill("100")
    own[1].fill("100")
    expect(page.get_by_text(FOUND_NOTHING)).to_be_visible()
    station.put_board_type(known)  # by someone else, meanwhile
    page.get_by_role("button", name="Store the program").click()
    expect(page.locator(".answer.refused")).to_contain_text("changed")
    assert station.types["demo-board"] == known
    page.reload()
    page.goto(f"{engineer.url}/#/setup/programs/demo-board")
    page.get_by_role("button", name="Begin a program").click()
    page.get_by_role("button", name="Store the program").click()
    expect(page.locator(".answer.done").last).to_contain_text("Stored.")
    page.get_by_role("button", name="Without a program of its own").click()
    expect(page.get_by_text("This board type has no program of its own any more.")).to_be_visible()
    page.get_by_role("button", name="Begin a program").click()
    for _ in range(2):
        page.get_by_role("button", name="Delete row 0").press("Enter")
    expect(page.get_by_role("button", name="Begin a program")).to_be_focused()
    expect(page.locator("#steps")).to_be_hidden()
    assert station.types["demo-board"] == known


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

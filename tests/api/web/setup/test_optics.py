"""Optics in a real browser: what the station knows, the drawing, constraints, and what would mend them."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from tests.api.held_station import CAMERAS

pytestmark = pytest.mark.browser

FIELDS = """() => [...document.querySelectorAll(".line-drawing .one-row")].map((e) =>
    ["x", "y", "width", "height"].map((name) => Number(e.getAttribute(name))))"""
STATION = re.compile(r"/optics/requirements\?of=station$")


def test_a_line_is_planned_from_what_the_station_knows(page: Page, engineer: Any, fits: Any) -> None:
    page.goto(f"{engineer.url}/#/setup/optics")
    expect(page.locator(".answer.missing")).to_have_text(
        "Still to be entered: Width of the sensor, Largest distance of the cameras."
    )
    expect(page.locator(".wanted label")).to_have_text(
        ["Width of the sensor, mm", "Largest distance of the cameras, mm"]
    )
    expect(page.locator("#optics-sensor_width_mm-help")).to_have_text("required")
    expect(page.get_by_label("Number of cameras")).to_have_value(str(CAMERAS))
    expect(page.locator("#optics-speed_mm_s-help")).to_have_text("from line.conveyor_mm_s")
    page.get_by_label("Width of the sensor").fill("many")
    page.keyboard.press("Tab")
    expect(page.locator(".answer.refused")).to_have_text("Width of the sensor is “many”; it must be a number.")
    expect(page.locator("[aria-invalid]")).to_have_count(1)
    page.get_by_label("Width of the sensor").fill("6,4")
    page.get_by_label("Largest distance of the cameras").fill("500")
    page.keyboard.press("Tab")
    expect(page.locator(".verdict")).to_have_text("All constraints that can be checked are met.")
    expect(page.locator(".wanted")).to_have_count(0)
    expect(page.locator(".constraint.open").first).to_have_text("open: Smallest distance of the cameras not given")
    # To scale: three fields of 40 × 30 mm, which overlap by 4 mm and end where the board ends.
    fields = page.evaluate(FIELDS)
    assert [[round(v, 3) for v in (x, width, height)] for x, _, width, height in fields] == [
        [0, 40, 30],
        [36, 40, 30],
        [72, 40, 30],
    ]
    expect(page.locator(".line-drawing .overlap")).to_have_count(2)
    page.get_by_label("Smallest distance of the cameras").fill("900")
    page.keyboard.press("Tab")
    expect(page.locator(".answer.refused")).to_contain_text("distance_min_mm is 900")
    expect(page.locator("#optics-distance_min_mm")).to_have_attribute("aria-invalid", "true")
    page.evaluate("localStorage.setItem('vaoi-language', 'de')")
    page.reload()  # the address has the values
    expect(page.locator(".answer.refused")).to_contain_text("im Widerspruch zu anderen Werten: Kleinster Abstand")
    expect(page.locator(".answer.refused [lang=en]")).to_be_hidden()


def test_what_a_person_does_first_is_not_replaced_by_a_late_reply(page: Page, engineer: Any) -> None:
    """The page opens with the values of the station; their reply may come after a person has chosen the example."""
    held: list[Route] = []
    page.route(STATION, lambda route, _: held.append(route))
    with page.expect_request(STATION):
        page.goto(f"{engineer.url}/#/setup/optics")
    page.get_by_role("button", name="Example of the paper").press("Enter")
    expect(page.locator(".verdict")).to_have_text("2 constraints are violated.")
    with page.expect_response(STATION):
        held[0].continue_()
    page.get_by_label("Number of cameras").fill("13")
    page.keyboard.press("Tab")
    expect(page.locator(".verdict")).to_have_text("1 constraint is violated.")

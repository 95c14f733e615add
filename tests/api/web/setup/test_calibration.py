"""Calibration in a real browser: print, film, follow the trial, judge, accept."""

from __future__ import annotations

import threading
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.api.held.setup_files import PITCH_MM, film_board
from tests.api.held_station import PX_PER_MM
from vaoi_station.api.setup.calibration import Trials
from vaoi_station.files.calibrations import Layout

pytestmark = pytest.mark.browser
FITTED_MS = 100_000
"""Longest time for a fit, which takes seconds on a machine without other load."""


def test_a_calibration_is_filmed_followed_judged_and_accepted(
    page: Page, engineer: Any, admin: str, fits: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_end, perform = threading.Event(), Trials.perform

    def waiting(trials: Trials, wanted: Any) -> None:
        assert may_end.wait(120)
        perform(trials, wanted)

    monkeypatch.setattr(Trials, "perform", waiting)
    page.goto(f"{admin}/#/setup/calibration")
    expect(page.get_by_text("No run has frames that can be read.")).to_be_visible()
    page.get_by_role("button", name="Calibrate").click()
    expect(page.locator(".answer.refused")).to_be_in_viewport(ratio=1)
    page.get_by_label("Distance from the edge").fill("9")
    page.keyboard.press("Tab")
    expect(page.locator(".answer.refused")).to_contain_text("Ask for")
    page.evaluate("localStorage.setItem('vaoi-language', 'de')")
    page.reload()
    expect(page.locator(".answer.refused")).to_contain_text("Ein Wert ist für die Station unbrauchbar.")
    expect(page.locator(".answer.refused [lang=en]")).to_be_hidden()
    fits("calibration-refused", ".answer.refused", lambda: page.evaluate(PICTURES))
    layout = page.evaluate("() => fetch('/api/v1/calibration/layout?tolerance_mm=1.5').then((r) => r.json())")
    run = film_board(engineer.station, Layout.model_validate(layout))
    page.reload()
    page.get_by_label("Distance from the edge").fill("1,5")
    page.keyboard.press("Tab")
    expect(page.locator(".answer.refused")).to_have_count(0)
    expect(page.locator("img.artwork")).not_to_have_js_property("naturalWidth", 0)
    expect(page.get_by_label("Run")).to_have_value(run)
    page.get_by_label("Row in which").fill("0")
    expect(page.locator(".frames img").first).not_to_have_js_property("naturalWidth", 0)
    expect(page.locator(".frames strong").last).to_have_text("23 marks, at least 10 expected")
    expect(page.locator(".found-marks circle")).to_have_count(67)
    engineer.station.film(board_id="next")  # a board that passes is chosen at once
    expect(page.locator("select[name=run]")).not_to_have_value(run)
    expect(page.locator(".frames .few").first).to_have_text("0 marks, at least 9 expected")
    page.get_by_label("Run").select_option(run)
    page.get_by_label("Row in which").fill("0")
    page.get_by_text("Limits and accuracy").click()
    page.get_by_label("Largest residual").fill("many")
    page.locator("#calibrate").click()
    expect(page.get_by_text("Largest residual is “many”; it must be a number.")).to_be_visible()
    page.get_by_label("Largest residual").fill("0.2")
    page.locator("#calibrate").click()
    expect(page.locator("progress")).to_be_visible()
    expect(page.locator("progress")).to_be_in_viewport()
    page.reload()  # the station goes on, and the page finds it again
    expect(page.locator("progress")).to_be_visible()
    expect(page.get_by_label("Distance from the edge")).to_have_value("1,5")
    expect(page.get_by_label("Row in which")).to_have_value("0")
    with page.expect_event("requestfailed", lambda request: request.url.endswith("/calibration/trial")):
        page.route("**/calibration/trial", lambda route: route.abort())
    page.unroute("**/calibration/trial")  # an answer that was lost ends nothing
    may_end.set()
    expect(page.get_by_role("heading", name="4. Judge it")).to_be_visible(timeout=FITTED_MS)
    expect(page.locator(".pictures img")).to_have_count(2)
    fits("calibration", "#accept", lambda: page.evaluate(PICTURES))
    page.locator("#accept").click()
    expect(page.locator(".answer.done")).to_contain_text("Written as calibration.json; the one before is kept as")
    page.get_by_role("button", name="Discard it").click()
    expect(page.locator(".pictures img")).to_have_count(0)
    page.reload()
    expect(page.locator(".frames img").first).to_be_visible()
    expect(page.locator(".pictures img")).to_have_count(0)


def test_marks_are_watched_while_the_board_is_being_laid(page: Page, engineer: Any, admin: str, fits: Any) -> None:
    station = engineer.station
    page.goto(f"{admin}/#/setup/calibration")
    layout = page.evaluate("() => fetch('/api/v1/calibration/layout?tolerance_mm=1.5').then((r) => r.json())")
    run = film_board(station, Layout.model_validate(layout))
    shown = {"row": 1}  # there is no board yet
    station.lighting.below = lambda camera: station.pixels[run, camera, shown["row"]]
    page.get_by_label("Distance from the edge").fill("1.5")
    page.keyboard.press("Tab")
    page.get_by_label("Camera that is watched").select_option("cam1")
    page.get_by_role("button", name="Watch its marks").press("Enter")
    live = page.locator(".live-marks")
    expect(live.locator("strong")).to_have_text("0 marks, at least 12 expected")
    expect(live.locator("strong")).to_have_class("few")
    shown["row"] = 0
    expect(live.locator("strong")).to_have_text("20 marks, at least 12 expected")
    expect(live.locator("circle")).to_have_count(20)
    expect(live.locator("img")).not_to_have_js_property("naturalWidth", 0)
    assert {camera for camera, _ in station.lighting.tried} == {1}
    station.arm("demo-board")
    expect(live.locator(".answer")).to_contain_text("The line is")
    expect(live.locator("figure")).to_be_hidden()
    station.disarm()
    page.get_by_role("button", name="Watch its marks").click()
    expect(live.locator("circle")).to_have_count(20)
    with page.expect_response(lambda response: response.request.method == "DELETE"):
        page.get_by_role("button", name="Stop watching").click()
    expect(live.locator("figure")).to_be_hidden()

    def watch() -> None:
        page.evaluate(PICTURES)
        page.locator("#watch-marks").click()
        expect(live.locator("circle")).not_to_have_count(0)

    fits("calibration-watched", "#watch-marks", watch)
    watch()
    before = station.lighting.ended
    with page.expect_response(lambda response: response.request.method == "DELETE"):
        page.goto(f"{admin}/#/boards")
    assert station.lighting.ended == before + 1


@pytest.mark.parametrize("engineer", [False], indirect=True)
def test_an_array_without_nominal_values_is_calibrated_by_what_is_entered(
    page: Page, engineer: Any, admin: str, fits: Any
) -> None:
    page.goto(f"{admin}/#/setup/calibration")
    refused = page.locator(".answer.refused")
    expect(refused).to_have_text(
        "station.toml does not state where the cameras are: enter the distance of the cameras and their resolution."
    )
    fits("calibration-nominal", ".answer.refused")
    run = film_board(engineer.station, Layout.model_validate(artwork(page, PITCH_MM, PX_PER_MM)))
    page.reload()
    page.get_by_label("Distance of cameras").fill(str(PITCH_MM))
    page.get_by_label("Resolution").fill(str(PX_PER_MM))
    page.get_by_label("Distance from the edge").fill("1.5")
    page.keyboard.press("Tab")
    expect(page.locator("img.artwork")).to_be_visible()
    expect(page.get_by_label("Run")).to_have_value(run)
    page.get_by_label("Row in which").fill("0")
    page.locator("#calibrate").click()
    expect(page.get_by_role("heading", name="4. Judge it")).to_be_visible(timeout=FITTED_MS)


def artwork(page: Page, pitch_mm: float, px_per_mm: float) -> Any:
    query = f"tolerance_mm=1.5&pitch_mm={pitch_mm}&px_per_mm={px_per_mm}"
    return page.evaluate("query => fetch(`/api/v1/calibration/layout?${query}`).then((r) => r.json())", query)


PICTURES = "() => Promise.allSettled([...document.querySelectorAll('.wizard img')].map((image) => image.decode()))"
"""Waits until every picture is loaded; a frame that never arrived has none."""

"""The operator's view in a real browser, against the service on loopback."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.web.conftest import PATIENCE_MS
from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.tables import StationState

pytestmark = pytest.mark.browser
COUNT_TONES = """
window.tones = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...when) { window.tones += 1; return start.apply(this, when); };
"""


def test_a_fault_is_shown_by_word_sign_colour_and_order(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page).to_have_title("Not armed – test")
    expect(page.locator("#verdict-word")).to_have_text("No board yet")
    expect(page.locator("#state-shape")).to_have_attribute("data-mark", "idle")
    served.station.fault("camera-absent", "Camera 2 does not answer.", "Check the cable of camera 2.")
    expect(page.locator("#state-word")).to_have_text("Fault")
    expect(page).to_have_title("Fault – test")
    expect(page.locator("#state-shape")).to_have_attribute("data-mark", "faulted")
    expect(page.locator("#state-word")).to_have_css("color", "rgb(176, 0, 32)")
    expect(page.locator("#reasons li")).to_be_hidden()
    page.locator("#why").click()
    expect(page.locator("#reasons li")).to_have_text(["Camera 2 does not answer. Check the cable of camera 2."])
    page.keyboard.press("Enter")
    expect(page.locator("#details")).to_be_hidden()


def test_title_and_tone_follow_the_station_in_every_view(page: Page, served: Any) -> None:
    station = served.station
    page.add_init_script(COUNT_TONES)
    station.arm("demo-board")
    page.goto(f"{served.url}/#/boards")
    expect(page).to_have_title("Ready – test")
    assert page.evaluate("tones") == 0
    station.fault("camera-absent", "Camera 2 does not answer.", "Check the cable of camera 2.")
    expect(page).to_have_title("Fault – test")
    assert page.evaluate("tones") == 1
    station.reasons = ()
    station.arm("demo-board")
    expect(page).to_have_title("Ready – test")
    run = station.film(finish=False, board_id="SN-47")
    station.finish(run, Status.FAILED)
    expect(page).to_have_title("Board failed – test")
    assert page.evaluate("tones") == 2
    for state, title in [("arming", "Arming"), ("blocked", "Memory full"), ("armed", "Board failed")] * 2:
        station.state = StationState(state)
        station.publish("station", state=state)
        expect(page).to_have_title(f"{title} – test")
    assert page.evaluate("tones") == 2, "a board is announced once"
    station.fault("camera-absent", "Camera 2 does not answer.", "Check the cable of camera 2.")
    expect(page).to_have_title("Fault – test")
    assert page.evaluate("tones") == 3, "each fault is"
    page.locator("#sound").click()
    station.reasons = ()
    station.arm("demo-board")
    expect(page).to_have_title("Board failed – test")
    station.fault("camera-absent", "Camera 2 does not answer.", "Check the cable of camera 2.")
    expect(page).to_have_title("Fault – test")
    assert page.evaluate("tones") == 3, "the sound is off"


def test_arming_without_a_lost_camera_takes_a_second_press(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#board-type")).to_have_value("demo-board")
    served.station.lose(2)
    page.locator("#arm").click()
    expect(page.locator("#answer")).to_contain_text("A camera is missing. Check its cable.")
    expect(page.locator("body")).not_to_contain_text("allow_lost_cameras")
    expect(page.locator("#state-word")).to_have_text("Not armed")
    expect(page.locator("#arm")).to_have_text("Arm without this camera")
    page.locator("#arm").click()
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#armed-with")).to_have_text("Armed for demo-board, without camera cam2")
    expect(page.locator("#why")).to_have_class("warned")
    served.station.held_back = (Reason(code="storage-full", message="The data disk is full."),)
    served.station.publish("line", "Boards are held back.")
    expect(page.locator("#state-word")).to_have_text("Hold")
    expect(page.locator("#order")).to_have_text("Hold the next board back. Call the administrator: data disk.")
    served.station.held_back = ()
    served.station.lose()
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#armed-with")).to_have_text("Armed for demo-board")
    expect(page.locator("#arm")).to_have_text("Disarm: hold")


def test_a_camera_that_is_lost_holds_the_next_board_back(page: Page, served: Any) -> None:
    served.station.arm("demo-board")
    page.goto(served.url)
    expect(page.locator("#state-word")).to_have_text("Ready")
    served.station.held_back = (Reason(code="line-filming", message="A board is in the barrier."),)
    served.station.lose(2)
    expect(page.locator("#state-word")).to_have_text("Camera missing")
    expect(page.locator("#order")).to_have_text("Hold the next board back. Check the camera's cable.")
    expect(page.locator("#lost")).to_have_text(
        re.compile(r"^Camera cam2 \(10\.1\.0\.2, switch A\) does not answer, since \d")
    )
    expect(page.locator("#armed-with")).to_have_text("Waits with demo-board")
    expect(page.locator("#state-shape")).to_have_attribute("data-mark", "lacking")
    expect(page.locator("#state-word")).to_have_css("color", "rgb(122, 75, 0)")
    page.locator("#why").click()
    expect(page.locator("#reasons li")).to_have_count(2)


def test_a_wide_screen_has_the_measures_of_the_last_board_and_the_next_order(page: Page, served: Any) -> None:
    station = served.station
    station.kept.trends.figures = lambda runs: {run: {"sigma_px": 0.0431, "ready_ms": 83.0} for run in runs}
    station.arm("demo-board", board_id="SN-48", runs=3)
    station.parts.teach(station.film())
    station.film(board_id="SN-47")
    page.set_viewport_size({"width": 1366, "height": 768})
    page.goto(served.url)
    measures = page.locator("#last-measures")
    expect(measures).to_contain_text("Parts in doubt2 of 3Frames10 of 12Parts not seen0")
    expect(measures).to_contain_text("σ of the worst part0.043 pxResult after the last frame83 ms")
    expect(page.locator("#next-orders li")).to_have_text(["demo-board, SN-48, 3 left"])
    served.station.finish(served.station.film(finish=False, board_id="SN-49"), Status.FAILED)
    expect(measures).not_to_contain_text("Parts in doubt")
    page.set_viewport_size({"width": 1280, "height": 800})
    expect(page.locator("#beside")).to_be_hidden()


def test_arming_works_by_keyboard_or_scanner_alone(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#board-type")).to_have_value("demo-board")
    reach(page, "arm")
    page.keyboard.press("Enter")
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#armed-with")).to_have_text("Armed for demo-board")
    page.keyboard.press("Space")
    expect(page.locator("#arm")).not_to_have_class(re.compile("holding"))
    expect(page.locator("#state-word")).to_have_text("Ready")
    for key in ("Space", "Enter"):
        page.keyboard.down(key)
        expect(page.locator("#state-word")).to_have_text("Not armed")
        page.keyboard.down(key)  # as a key that is held does again and again
        page.keyboard.up(key)
        expect(page.locator("#arm")).to_have_text("Arm")
        assert served.station.armed is None, "the release is no order to arm"
        page.keyboard.press("Enter")
        expect(page.locator("#state-word")).to_have_text("Ready")
    page.locator("#board-id").focus()
    page.keyboard.type("SN-77")
    page.keyboard.press("Enter")  # as a scanner does
    expect(page.locator("#armed-with")).to_have_text("Armed for demo-board, board SN-77")
    expect(page.locator("#board-id")).to_have_value("")


def test_a_refusal_is_said_in_the_language_of_the_page(browser: Browser, served: Any) -> None:
    types = dict(served.station.types)
    for language, said in (("en", "This type is not stored"), ("de", "Dieser Typ ist nicht mehr gespeichert.")):
        served.station.types.update(types)
        page = browser.new_page(locale=language)
        page.set_default_timeout(PATIENCE_MS)
        page.goto(served.url)
        expect(page.locator("#board-type")).to_have_value("demo-board")
        served.station.types.clear()
        page.locator("#arm").click()
        expect(page.locator("#answer")).to_contain_text(said)
        sentence = page.get_by_text("There is no board type 'demo-board'.")
        expect(sentence).to_be_hidden()
        page.locator("#answer summary").press("Enter")
        expect(sentence).to_be_visible()
        served.station.state = StationState.BLOCKED
        served.station.publish("station", state="blocked")
        expect(page.locator("#answer")).to_be_empty()
        served.station.disarm()
        page.close()


def test_old_data_are_marked_until_new_data_come(page: Page, station: Any, serve: Callable[..., Any]) -> None:
    server = serve(station)
    station.arm("demo-board")
    page.goto(server.url)
    expect(page.locator("#state-word")).to_have_text("Ready")
    server.stop()
    expect(page.locator("body")).to_have_class(re.compile("stale"))
    expect(page.locator("#stale-age")).to_contain_text("No data for")
    expect(page.locator("#state-word")).to_have_text("No data")
    expect(page.locator("#order")).to_have_text("Hold boards back. Check station and network.")
    expect(page).to_have_title("No data – test")
    expect(page.locator("#arm")).to_be_disabled()
    station.closed = False
    again = serve(station, server.port)
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#stale")).to_be_hidden()
    expect(page.locator("#arm")).to_be_enabled()
    again.stop()


def reach(page: Page, target: str) -> None:
    """Move the focus there with the tabulator key; the focused element must be visible."""
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == target:
            assert page.locator(f"#{target}").evaluate("e => getComputedStyle(e).outlineStyle") == "solid"
            return
    pytest.fail(f"{target} cannot be reached by keyboard")

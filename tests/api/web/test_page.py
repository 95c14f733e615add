"""The operator's page in a real browser, against the service on loopback."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from vaoi_station.model import Status
from vaoi_station.runs.states.schemas import Reason

pytestmark = pytest.mark.browser
MUCH_LATER_S = 60


def test_the_page_shows_state_and_instruction(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#state-word")).to_have_text("Not armed")
    expect(page.locator("#what-to-do")).to_have_text("Choose the board type and press Arm.")
    expect(page.locator("#verdict-word")).to_have_text("No board yet")
    expect(page).to_have_title("Not armed – test")


def test_a_fault_is_shown_by_word_shape_colour_and_instruction(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#state-shape")).to_have_attribute("data-mark", "idle")
    served.station.fault("camera-lost", "Camera 2 does not answer.", "Check the cable of camera 2.")
    expect(page.locator("#state-word")).to_have_text("Fault")
    expect(page.locator("#what-to-do")).to_have_text("Check the cable of camera 2.")
    expect(page.locator("#reasons li")).to_have_text(["Camera 2 does not answer."])
    expect(page.locator("#state-shape")).to_have_attribute("data-mark", "faulted")
    expect(page.locator("#state-word")).to_have_css("color", "rgb(176, 0, 32)")


def test_a_late_retry_is_shown_with_its_time(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#state-word")).to_have_text("Not armed")
    refuse_its_settings(served.station)
    lines = page.locator("#reasons li")
    expect(lines).to_have_count(2)
    expect(lines.nth(1)).to_have_text(re.compile(r"^Next attempt for acquisition: \d+:\d\d:\d\d.*\.$"))
    served.station.next_try = None
    served.station.publish("process", "It is being started again.")
    expect(lines).to_have_count(1)


def test_the_page_requests_the_state_after_a_retry(page: Page, served: Any) -> None:
    page.route("**/events?*", lambda route: route.abort())
    page.clock.install()
    refuse_its_settings(served.station)
    page.goto(served.url)
    expect(page.locator("#verdict-word")).to_have_text("No board yet")  # it has asked for all it wants to know
    lines = page.locator("#reasons li")
    expect(lines).to_have_count(2)
    served.station.next_try = None
    page.clock.fast_forward((MUCH_LATER_S + 10) * 1000)
    expect(lines).to_have_count(1)


def test_a_drift_is_shown_while_boards_are_filmed(page: Page, served: Any) -> None:
    served.station.arm("demo-board")
    page.goto(served.url)
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#warnings")).to_be_hidden()
    served.station.drift()
    expect(page.locator("#warnings li")).to_have_text(
        ["Camera cam1 is displaced by 9.40 px from its calibration. Call the engineer."]
    )
    expect(page.locator("#what-to-do")).to_have_text("Let the next board in.")
    served.station.warnings = ()
    served.station.publish("calibration", "Camera cam1 is back at its calibrated position.")
    expect(page.locator("#warnings")).to_be_hidden()


def test_a_database_that_was_set_aside_is_acknowledged_by_a_button(page: Page, served: Any) -> None:
    name = "station.db.damaged-20260101T000000Z"
    served.station.storage.files[name] = False
    page.goto(served.url)
    button = page.get_by_role("button", name=f"Acknowledge {name}")
    button.click()
    expect(page.locator("#answer")).to_have_text(f"The warning about {name} was acknowledged.")
    expect(button).to_have_count(0)
    expect(page.locator("#set-aside")).to_be_hidden()


def test_arming_without_a_lost_camera_takes_a_second_press(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#board-type")).to_have_value("demo-board")
    served.station.lose(2)
    page.locator("#arm").click()
    expect(page.locator("#answer")).to_have_text("The array is not complete. Check its cable.")
    expect(page.locator("#state-word")).to_have_text("Not armed")
    expect(page.locator("#arm")).to_have_text("Arm anyway")
    page.locator("#arm").click()
    expect(page.locator("#state-word")).to_have_text("Camera missing")
    expect(page.locator("#state-shape")).to_have_attribute("data-mark", "lacking")
    expect(page.locator("#state-word")).to_have_css("color", "rgb(122, 75, 0)")
    expect(page.locator("#what-to-do")).to_have_text("Hold the next board back. It would be filmed without one camera.")
    expect(page.locator("#reasons li")).to_have_text(["Camera cam2 is not connected. Check its cable."])
    served.station.lose()
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#arm")).to_have_text("Arm")


def test_only_faults_are_red(page: Page, served: Any) -> None:
    page.goto(served.url)
    for state, word in (("armed", "Ready"), ("filming", "Filming"), ("blocked", "Memory full"), ("idle", "Not armed")):
        served.station.state = state
        served.station.publish("station", state=state)
        expect(page.locator("#state-word")).to_have_text(word)
        expect(page.locator("#state-shape")).to_have_attribute("data-mark", state)
        expect(page.locator("#state-word")).not_to_have_css("color", "rgb(176, 0, 32)")


def test_the_last_board_and_its_pictures_are_updated(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#verdict-word")).to_have_text("No board yet")
    served.station.film(board_id="SN-1")
    expect(page.locator("#verdict-word")).to_have_text("Pictures good")
    expect(page.locator("#facts")).to_contain_text("SN-1")
    expect(page.locator("#facts")).to_contain_text("10 of 12 good (1 incomplete, 1 missing), 4 rows × 3 cameras")
    expect(page.locator("#component")).to_have_value("U1")
    wait_for_pictures(page, 10)
    served.station.film(verdict=Status.DEGRADED, board_id="SN-2")
    expect(page.locator("#verdict-word")).to_have_text("Pictures with reservations")
    expect(page.locator("#facts")).to_contain_text("SN-2")
    wait_for_pictures(page, 10)


def test_a_degraded_board_says_first_what_to_do(page: Page, served: Any) -> None:
    """Each order once, although two reasons need it; then all reasons."""
    page.goto(served.url)
    run = served.station.film(finish=False)
    causes = ("rows-lost", "camera-absent", "camera-displaced", "")
    reasons = tuple(Reason(code="result", message=f"Reason {n}.", cause=c) for n, c in enumerate(causes))
    served.station.finish(run, Status.DEGRADED, reasons)
    expect(page.locator("#verdict-reason")).to_have_text(
        "Film this board again. If this recurs, call the engineer. "
        "Call the engineer: cameras or trigger need attention. Reason 0. Reason 1. Reason 2. Reason 3."
    )


def test_the_chosen_component_is_kept(page: Page, served: Any) -> None:
    served.station.film()
    page.goto(served.url)
    page.locator("#component").select_option("2/R1")
    wait_for_pictures(page, 3)
    expect(page.locator("figure img").first).to_have_attribute("alt", "2/R1, camera 0, row 3")
    served.station.film(board_id="next")
    expect(page.locator("#facts")).to_contain_text("next")
    expect(page.locator("#component")).to_have_value("2/R1")


def test_pictures_no_longer_in_memory_are_not_shown(page: Page, served: Any) -> None:
    run = served.station.film()
    page.goto(served.url)
    wait_for_pictures(page, 10)
    served.station.release(run)
    expect(page.locator("#pictures")).to_have_text("The pictures of this board are no longer in memory.")


def test_arming_works_by_keyboard_alone(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#board-type")).to_have_value("demo-board")
    reach(page, "arm")
    page.keyboard.press("Enter")
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#armed-with")).to_have_text("Board type demo-board.")
    reach(page, "disarm")
    page.keyboard.press("Space")
    expect(page.locator("#state-word")).to_have_text("Not armed")


def test_a_scanner_enters_the_board_id_and_arms(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#board-type")).to_have_value("demo-board")
    reach(page, "board-id")
    page.keyboard.type("SN-77")
    page.keyboard.press("Enter")
    expect(page.locator("#armed-with")).to_have_text("Board type demo-board, board SN-77.")
    expect(page.locator("#board-id")).to_have_value("")


def test_a_refusal_is_shown_with_its_action(page: Page, served: Any) -> None:
    page.goto(served.url)
    expect(page.locator("#board-type")).to_have_value("demo-board")
    served.station.types.clear()
    page.locator("#arm").click()
    expect(page.locator("#answer")).to_have_text("There is no board type 'demo-board'. Teach it.")
    expect(page.locator("#state-word")).to_have_text("Not armed")


def test_old_data_are_marked_until_new_data_come(page: Page, station: Any, serve: Callable[..., Any]) -> None:
    server = serve(station)
    station.arm("demo-board")
    page.goto(server.url)
    expect(page.locator("#state-word")).to_have_text("Ready")
    server.stop()
    expect(page.locator("body")).to_have_class("stale")
    expect(page.locator("#stale-age")).to_contain_text("No data for")
    expect(page.locator("#state-word")).to_have_text("Unknown")
    expect(page.locator("#arm")).to_be_disabled()


def test_a_page_reconnects_to_the_event_stream(page: Page, station: Any, serve: Callable[..., Any]) -> None:
    server = serve(station)
    page.goto(server.url)
    expect(page.locator("#state-word")).to_have_text("Not armed")
    server.stop()
    expect(page.locator("#stale")).to_be_visible()
    station.closed = False
    station.arm("demo-board")
    again = serve(station, server.port)
    expect(page.locator("#state-word")).to_have_text("Ready")
    expect(page.locator("#stale")).to_be_hidden()
    expect(page.locator("#arm")).to_be_enabled()
    again.stop()


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (1920, 1080)])
def test_the_page_fits_the_screen_with_large_targets(page: Page, served: Any, width: int, height: int) -> None:
    served.station.film(board_id="SN-1")
    page.set_viewport_size({"width": width, "height": height})
    page.goto(served.url)
    wait_for_pictures(page, 10)
    assert page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [
        width,
        height,
    ]
    for target in page.locator("button, select, input, a").all():
        box = target.bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 56, target
        assert box["y"] + box["height"] <= height


def test_texts_have_enough_contrast(page: Page, served: Any) -> None:
    served.station.film(verdict=Status.DEGRADED)
    served.station.fault("x", "Message.", "Action.")
    page.goto(served.url)
    wait_for_pictures(page, 10)
    words = (
        "h1, h2, #version, nav a, #state-word, #what-to-do, #reasons li, label, select, button, #verdict-word, dt, dd"
    )
    for element in [*page.locator(words).all(), *page.locator("figcaption").all()]:
        assert contrast(element) >= 4.5, element


def test_the_api_documentation_needs_no_network(page: Page, served: Any) -> None:
    paths = served.client.get("/api/v1/openapi.json").json()["paths"]
    page.goto(f"{served.url}/docs")
    expect(page.locator(".opblock")).to_have_count(sum(map(len, paths.values())))


def refuse_its_settings(station: Any) -> None:
    """A fault whose next attempt is much later."""
    station.next_try = (datetime.now(UTC) + timedelta(seconds=MUCH_LATER_S)).isoformat(timespec="milliseconds")
    station.fault("setting-refused", "Camera 2 refuses Gain = 99.", "Set what it can do.")


def wait_for_pictures(page: Page, count: int) -> None:
    """Wait until every picture is shown."""
    expect(page.locator("figure")).to_have_count(count)
    for image in page.locator("figure img").all():
        expect(image).not_to_have_js_property("naturalWidth", 0)
    expect(page.locator("figure.unloadable")).to_have_count(0)


def reach(page: Page, target: str) -> None:
    """Move the focus there with the tabulator key; the focused element must be visible."""
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == target:
            assert page.locator(f"#{target}").evaluate("e => getComputedStyle(e).outlineStyle") == "solid"
            return
    pytest.fail(f"{target} cannot be reached by keyboard")


def contrast(element: Locator) -> float:
    """Contrast ratio of an element's text and background (WCAG 2)."""
    ink, ground = element.evaluate("""e => {
        const ink = getComputedStyle(e).color;
        while (e && getComputedStyle(e).backgroundColor === "rgba(0, 0, 0, 0)") e = e.parentElement;
        return [ink, e ? getComputedStyle(e).backgroundColor : "rgb(255, 255, 255)"];
    }""")
    lighter, darker = sorted((luminance(ink), luminance(ground)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(color: str) -> float:
    parts = [float(p) / 255 for p in color.removeprefix("rgb(").removesuffix(")").split(",")]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

"""Both sides of a board as one page; boards of one side have nothing of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.held_station import BOARD, HeldStation
from tests.api.routes.test_boards import beside
from tests.api.web.test_views import examine, wide_elements
from vaoi_station.model import BoardType, Status

pytestmark = pytest.mark.browser
PARTS = [
    {"ref": "C7", "center": [12, 28], "width": 4, "height": 2, "rotation": 30},
    {"ref": "L1", "center": [40, 20], "width": 8, "height": 8},
]


def film_both(station: HeldStation, board_id: str, bottom: Status = Status.OK, **film: Any) -> tuple[str, str]:
    """Film a board and, turned over, its bottom."""
    lower = BOARD | {"name": "demo-bottom", "side": "bottom", "components": PARTS}
    station.types["demo-bottom"] = BoardType.model_validate(lower)
    top = station.film(board_id=board_id)
    return top, station.film(board_id=board_id, verdict=bottom, board_type="demo-bottom", **film)


def test_a_board_of_two_sides_is_one_page_and_one_key_changes_sides(page: Page, served: Any) -> None:
    top, bottom = film_both(served.station, "SN/1 a")
    page.goto(f"{served.url}/#/board/{top}")
    expect(page.locator("#other-side")).to_have_accessible_name("Bottom: Pictures good (Alt+S)")
    page.keyboard.press("Alt+s")
    expect(page.locator("#other-side")).to_have_accessible_name("Top: Pictures good (Alt+S)")
    assert page.url.partition("?")[0].endswith(f"/#/board/{bottom}")
    page.locator("#both-sides").click()
    expect(page.locator("#sides-title")).to_have_text("SN/1 a: Pictures good")
    expect(page.locator("#sides-flip")).to_have_text("Turned over about y (CAD data)")
    expect(page.locator(".board-side .board-picture")).to_have_count(2)
    expect(page.locator("#side-bottom .side-facts")).to_contain_text("demo-bottom, 2 parts")
    page.keyboard.press("Alt+s")
    expect(page.locator("#side-top")).to_be_focused()
    page.keyboard.press("Alt+s")
    expect(page.locator("#side-bottom")).to_be_focused()
    page.locator("#sides-part").fill("X9")
    page.keyboard.press("Enter")
    expect(page.locator("#sides-answer")).to_have_text("There is no part X9.")
    page.locator("#sides-part").fill("l1")
    page.keyboard.press("Enter")
    expect(page.locator("#component")).to_have_value("L1")
    assert f"/#/board/{bottom}?" in page.url


def test_the_map_shows_the_bottom_from_below_and_a_press_leads_to_a_part(page: Page, served: Any) -> None:
    film_both(served.station, "SN-1")
    page.goto(f"{served.url}/#/sides/SN-1")
    bottom = page.locator("#side-bottom .side-map")
    left, right = (page.locator(f"#side-{name} .side-map .edge").bounding_box() for name in ("top", "bottom"))
    assert left is not None
    assert right is not None
    # L1 is at x = 40 of 60 as seen from the top, so a third from the left as seen from below.
    page.mouse.click(right["x"] + right["width"] / 3, right["y"] + right["height"] / 2)
    expect(page.locator("#component")).to_have_value("L1")
    page.go_back()
    expect(bottom).to_be_visible()
    page.mouse.click(left["x"] + left["width"] / 3, left["y"] + left["height"] / 2)
    expect(page.locator("#component")).to_have_value("U1")


def test_a_board_of_one_side_shows_nothing_of_sides(page: Page, served: Any) -> None:
    run = served.station.film(board_id="SN-1")
    with page.expect_response("**/api/v1/boards/*"):
        page.goto(f"{served.url}/#/board/{run}")
    expect(page.locator("#later")).to_have_count(0)
    expect(page.locator("#sides-of-board")).to_be_hidden()


def test_what_is_wrong_with_a_side_is_said_and_what_still_comes_appears(page: Page, served: Any) -> None:
    station = served.station
    _, bottom = film_both(station, "SN-1", finish=False)
    page.goto(f"{served.url}/#/sides/SN-1")
    expect(page.locator("#side-bottom")).to_contain_text("Its pictures still come.")
    expect(page.locator("#sides-reasons")).to_contain_text("Wait until its run has finished.")
    station.finish(bottom, Status.FAILED)
    expect(page.locator("#side-bottom h3")).to_have_text("Bottom: No usable pictures")
    expect(page.locator("#sides-reasons")).to_have_text(f"The bottom, run {bottom}, failed. Film it again.")
    expect(page.locator("#sides-head")).to_have_attribute("data-verdict", "failed")
    page.goto(f"{served.url}/#/sides/SN-9")
    expect(page.locator("#sides-title")).to_have_text("There is no such board.")


def test_a_side_that_another_station_films_is_shown_with_its_map_and_a_link_to_it(
    page: Page, served: Any, tmp_path: Path
) -> None:
    lower = BOARD | {"side": "bottom", "components": PARTS}
    served.station.types["demo-board"] = BoardType.model_validate(lower)
    served.station.film(board_id="SN-1")
    first = beside(served.url, tmp_path, HeldStation())
    try:
        run = first.station.film(board_id="SN-1")
        page.goto(f"{first.url}/#/board/{run}")
        expect(page.locator("#other-side")).to_have_attribute("href", f"{served.url}/#/board/r000001")
        page.locator("#both-sides").click()
        expect(page.locator("#side-bottom .side-picture")).to_have_text(
            "Its pictures are at the station that filmed it."
        )
        expect(page.locator(".side-map")).to_have_count(2)
    finally:
        first.stop()


def test_the_german_page_translates_reasons_and_fits(browser: Browser, served: Any) -> None:
    film_both(served.station, "SN-48-of-a-long-series", Status.DEGRADED)
    context = browser.new_context(locale="de", color_scheme="dark")
    page = context.new_page()
    page.goto(f"{served.url}/#/sides/SN-48-of-a-long-series")
    expect(page.locator("#sides-reasons li")).to_contain_text("Die Gründe ihres Laufs ansehen.")
    for width, height in ((390, 844), (1366, 768), (1920, 1080)):
        page.set_viewport_size({"width": width, "height": height})
        assert wide_elements(page) == [], width
        assert examine(page) == [], width
    context.close()


def test_an_address_that_cannot_be_read_leads_to_no_board(page: Page, served: Any) -> None:
    page.goto(f"{served.url}/#/sides/%zz")
    expect(page.locator("#sides-title")).to_have_text("There is no such board.")

"""Board types in a real browser: from a file to an approved type, laid over a filmed board, and one step back."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.api.routes.test_board_types import proposing
from tests.board_data.readers import samples

pytestmark = pytest.mark.browser

TABLE = "Ref,X,Y,Rot\nR1,110,10,0\nJ1,130,20,90\nFID1,105,5,0\nTP2,140,5,0\n"

TILES = """() => Promise.all([...document.querySelectorAll(".laying image")].map((tile) => {
    const picture = new Image();
    picture.src = tile.href.baseVal;
    return picture.decode();
}))"""
"""Waits until every tile of the picture is loaded."""


def choose_file(page: Page, field: str, name: str, text: str) -> None:
    page.locator(field).set_input_files({"name": name, "mimeType": "text/plain", "buffer": text.encode()})


def test_a_table_that_is_refused_is_read_with_the_columns_that_the_message_asks_for(page: Page, engineer: Any) -> None:
    page.goto(f"{engineer.url}/#/setup")
    table = "Ref,X (mm),Y (mm),Ugol\nR1,110,10,0\nJ1,130,20,90\nTP2,140,5,0\n"
    choose_file(page, "#board-file", "places.csv", table)
    expect(page.locator(".answer.refused").first).to_contain_text("no column is recognised as the rotation")
    page.get_by_label("Columns, as the message names them").fill("rotation=4")
    page.keyboard.press("Tab")
    expect(page.locator(".board-drawing .body")).to_have_count(3)
    expect(page.get_by_label("Column of the rotation")).to_have_value("4")
    page.get_by_label("Column of the rotation").select_option(label="none")
    expect(page.locator(".warnings")).to_contain_text("rotation")
    expect(page.locator(".board-drawing .body")).to_have_count(3)


def test_a_file_becomes_an_approved_board_type(page: Page, engineer: Any, fits: Any) -> None:
    page.goto(f"{engineer.url}/#/setup")
    expect(page.get_by_role("link", name="demo-board")).to_be_visible()
    fits("types", ".table")
    choose_file(page, "#board-file", "places.csv", TABLE)
    expect(page.get_by_role("heading", name="places.csv")).to_be_visible()
    expect(page.locator(".board-drawing .body.guess")).to_have_count(4)
    expect(page.locator(".warnings")).to_contain_text("1 fiducial is missing")
    page.get_by_label("Column of the rotation").select_option(label="none")
    page.get_by_label("Unit").select_option("mil")
    expect(page.locator(".size")).to_contain_text("mm, bar")
    page.get_by_label("Unit").select_option("mm")
    expect(page.locator(".facts")).to_contain_text("mm (")
    page.get_by_text("The boards run as a panel of which the file has no data").click()
    for label, value in (("Boards along x and y", "2 × 1"), ("From board to board, mm", "60")):
        page.get_by_label(label).fill(value)
        page.keyboard.press("Tab")
    refused = page.locator(".answer.refused")
    expect(refused).to_have_text("From board to board, mm: “60” must be written like 30x28.5.")
    expect(page.locator(".board-drawing .body")).to_have_count(4)
    page.get_by_label("From board to board, mm").fill("60,5 x 0")
    page.keyboard.press("Tab")
    expect(page.locator(".facts")).to_contain_text("Boards of the panel2")
    expect(page.locator(".warnings")).to_contain_text("State how far it is from the boards to the edges of the panel.")
    page.get_by_label("Boards along x and y").fill("")
    page.keyboard.press("Tab")
    expect(page.locator(".facts")).not_to_contain_text("Boards of the panel")
    page.get_by_label("Name of the board type").fill("product-7")
    page.keyboard.press("Tab")
    expect(page.get_by_role("button", name="Store as product-7")).to_be_visible()
    choose_file(page, "#join-file", "board.kicad_pcb", samples.KICAD)
    expect(page.get_by_text("Bodies and outline come from the second file.")).to_be_visible()
    page.reload()  # what was uploaded is kept by the station
    expect(page.locator(".facts")).to_contain_text("centroid + kicad")
    fits("preview", ".board-drawing")
    page.get_by_role("button", name="Without the second file").click()
    expect(page.locator(".facts")).not_to_contain_text("centroid + kicad")  # then the page is drawn anew
    page.get_by_text("Name a part as a mark").click()
    for part in ("TP9", "TP2"):
        page.get_by_label("Part", exact=True).fill(part)
        page.get_by_role("button", name="Add").click()
        if part == "TP9":
            expect(page.get_by_text("There is no part “TP9”.")).to_be_visible()
    expect(page.locator(".board-drawing .mark")).to_have_count(2)
    page.get_by_role("button", name="Store as product-7").click()
    expect(page.get_by_role("heading", name="product-7", exact=True)).to_be_visible()
    assert [f.name for f in engineer.station.types["product-7"].fiducials] == ["FID1", "TP2"]
    page.get_by_label("Revision of the data").fill("B")
    page.get_by_role("button", name="Retire").click()
    expect(page.locator(".state")).to_have_text("retired")
    assert engineer.station.types["product-7"].revision == "B"
    page.get_by_label("Revision of the data").fill("")
    page.get_by_role("button", name="Keep").click()
    expect(page.locator(".answer.done")).to_have_text("Kept.")
    assert engineer.station.types["product-7"].revision is None
    assert engineer.station.types["product-7"].state == "retired"
    page.get_by_role("button", name="Approve").click()
    expect(page.locator(".state")).to_have_text("approved")
    page.locator("#step-back").click()
    expect(page.locator(".state")).to_have_text("retired")
    fits("type", ".board-drawing")
    page.get_by_role("button", name="Delete this board type").click()
    expect(page.get_by_role("heading", name="Deleted")).to_be_visible()


def test_what_the_station_refuses_is_shown(page: Page, engineer: Any) -> None:
    page.goto(f"{engineer.url}/#/setup/types")
    choose_file(page, "#board-file", "notes.txt", "nonsense")
    refused = page.locator(".answer.refused")
    expect(refused).to_contain_text("notes.txt")
    page.evaluate("localStorage.setItem('vaoi-language', 'de')")
    page.reload()
    expect(refused).to_contain_text("Die Datei lässt sich so nicht lesen. Einzelheiten (englisch)")
    expect(refused.locator("[lang=en]")).to_be_hidden()
    page.evaluate("localStorage.setItem('vaoi-language', 'en')")
    page.reload()
    page.get_by_role("button", name="Discard the file").click()
    expect(page.locator("#drop")).to_be_visible()
    before = engineer.station.types["demo-board"]
    choose_file(page, "#board-file", "board.kicad_pcb", samples.KICAD)
    page.get_by_label("Name of the board type").fill("demo-board")
    page.keyboard.press("Tab")
    page.get_by_role("button", name="Store as demo-board").click()
    expect(page.locator(".answer.refused")).to_contain_text("There is a board type demo-board already")
    assert engineer.station.types["demo-board"] == before
    page.get_by_role("button", name="Replace demo-board now").click()
    expect(page.get_by_role("heading", name="demo-board", exact=True)).to_be_visible()
    assert engineer.station.types["demo-board"] != before
    page.goto(f"{engineer.url}/#/setup/types/of/unknown")
    expect(page.locator(".answer.refused")).to_contain_text("There is no board type 'unknown'.")


def test_a_board_type_is_laid_over_a_filmed_board_and_moved_by_keys(page: Page, engineer: Any, fits: Any) -> None:
    station = engineer.station
    run = station.film(board_id="SN-1")
    page.goto(f"{engineer.url}/#/setup/types/of/demo-board")
    page.locator("#lay").click()
    expect(page.locator(".laying image")).not_to_have_count(0)
    expect(page.locator(".laid .body")).to_have_count(3)
    page.evaluate(TILES)
    fits("lay", ".laying image", lambda: page.evaluate(TILES))
    page.locator(".laying").focus()
    for key in ("ArrowRight", "ArrowRight", "ArrowUp", "["):
        page.keyboard.press(key)
    expect(page.get_by_label("x, mm")).to_have_value("0.2")
    expect(page.get_by_label("y, mm")).to_have_value("0.1")
    expect(page.get_by_label("Turn, °")).to_have_value("0.1")
    page.reload()  # the address has the move
    expect(page.get_by_label("Turn, °")).to_have_value("0.1")
    expect(page.get_by_label("x, mm")).to_have_value("0.2")
    page.get_by_label("Turn, °").fill("0")
    expect(page).not_to_have_url(re.compile("turn="))
    page.get_by_role("button", name="Store as a draft").click()
    expect(page.locator(".answer.done")).to_have_text("Stored as a draft. The version before can be restored.")
    stored = station.types["demo-board"]
    assert (stored.state, stored.components[0].center) == ("draft", (20.2, 20.1))
    proposing(station)
    page.locator("#check").click()
    expect(page.locator("figure img")).to_have_count(1)
    expect(page).to_have_url(re.compile(f"run={run}&measure=1"))
    page.reload()  # the result is shown again without a press
    page.locator("#correct").click()
    expect(page.locator(".answer.done")).to_contain_text("Stored as a draft")
    assert station.types["demo-board"].revision == "A corrected"
    page.route("**/mosaics/**", lambda route: route.abort())
    page.reload()
    expect(page.locator(".answer.refused")).to_contain_text("Parts of the picture were not sent")
    page.route("**/mosaics", lambda route: route.fulfill(json={"mosaics": []}))
    page.reload()
    expect(page.locator(".drawing .refused")).to_contain_text("There is no picture of the whole board")
    station.release(run)  # a recording at most
    page.reload()
    expect(page.get_by_text("There is no board of this type with usable pictures in memory.")).to_be_visible()


def test_a_run_is_taught_as_reference(page: Page, engineer: Any) -> None:
    run = engineer.station.film(board_id="SN-1")
    page.goto(f"{engineer.url}/#/setup/types/of/demo-board")
    page.get_by_role("button", name="Make it the reference").click()
    expect(page.get_by_text(re.compile(f"Run {run}, taught"))).to_be_visible()
    page.get_by_role("button", name="Delete the reference").click()
    expect(page.get_by_text("None. Boards are placed by their fiducials.")).to_be_visible()

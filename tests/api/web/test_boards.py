"""Boards in a real browser: the last one, decisions about it, the list with its filters, one with its pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from vaoi_station.model import Reason, Status
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.tables import StationState
from vaoi_station.store.figures import BoardRow

pytestmark = pytest.mark.browser
FIGURES = {
    "unseen_parts": "3",
    "sigma_px": "0.123",
    "residual_px": "0.061",
    "seam_px": "0.310",
    "slip_percent": "-1.50",
}
"""What the list shows of a board, by column."""


def fail(station: Any, board_id: str, verdict: Status = Status.FAILED, **fields: Any) -> str:
    run = station.film(finish=False, board_id=board_id)
    station.filmed[run] = station.filmed[run].model_copy(update=fields)
    station.finish(run, verdict, (Reason(code="stitch-failed", message="Rows are lost.", cause="rows-lost"),))
    return str(run)


def test_a_failed_board_stays_until_somebody_decides(page: Page, served: Any) -> None:
    station = served.station
    station.arm("demo-board")
    page.goto(served.url)
    expect(page.locator("#state-word")).to_have_text("Ready")
    run = fail(station, "SN-47")
    expect(page.locator("#state-word")).to_have_text("Board failed")
    expect(page).to_have_title("Board failed – test")
    expect(page.locator("#verdict-word")).to_have_text("No usable pictures")
    station.film(board_id="SN-48")
    expect(page.locator("#verdict-word")).to_have_text("Pictures good")
    expect(page.locator("#order")).to_contain_text("Board SN-47: no pictures.")
    fail(station, "SN-49", Status.DEGRADED)
    expect(page.locator("#order")).to_contain_text("Board SN-49")
    page.get_by_role("button", name="Use it anyway").click()
    page.get_by_label("Your name").fill("Ada")
    page.get_by_label("Reason").fill("R7 is not tested.")
    page.keyboard.press("Enter")
    expect(page.locator("#board-order")).to_have_text("Used, decided by Ada")
    expect(page.locator("#order")).to_contain_text("Board SN-47")
    page.get_by_role("button", name="SN-47: Film again").click()
    for n in range(22):
        station.film(board_id=f"SN-{n + 50}")
    expect(page.locator("#board-name")).to_have_text("SN-71")
    expect(page.locator("#order")).to_contain_text("Board SN-47")
    expect(page.get_by_label("Your name")).to_have_value("Ada")
    expect(page.get_by_label("Reason")).to_have_value("rows-lost")
    page.keyboard.press("Enter")
    expect(page.locator("#state-word")).to_have_text("Ready")
    assert station.kept.history.made[run].choice == "film-again"
    expect(page.locator("#counts")).to_have_text("Today23good1with reservations1failed0missed")


def test_an_open_decision_stays_while_further_boards_come(page: Page, served: Any) -> None:
    station = served.station
    station.arm("demo-board")
    run = fail(station, "SN-47")
    page.goto(served.url)
    page.get_by_role("button", name="Film again").click()
    page.get_by_label("Your name").fill("Ada")
    station.state = StationState.FILMING
    station.publish("station", state="filming")
    expect(page.locator("#state-word")).to_have_text("Filming")
    expect(page.get_by_label("Your name")).to_have_value("Ada")
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Film again").click()
    station.state = StationState.ARMED
    station.film(board_id="SN-48")
    expect(page.locator("#board-name")).to_have_text("SN-48")
    fail(station, "SN-49", Status.DEGRADED)
    expect(page.locator("#order")).to_contain_text("SN-49")
    expect(page.locator("#decision button").first).to_have_text("SN-47: Film again")
    station.kept.history.decide(run, "use", "Bob", "It was decided on another page.")
    expect(page.locator("#decision")).to_have_count(0)
    page.get_by_role("button", name="Use it anyway").click()
    station.film(board_id="SN-50")
    expect(page.locator("#board-name")).to_have_text("SN-50")
    expect(page.locator("#decision button").first).to_have_text("SN-49: Use it anyway")
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#actions button")).to_have_count(0)


def test_a_board_that_ends_while_the_page_reads_is_counted_once(page: Page, served: Any) -> None:
    """It ends after the list of runs was read, and before the counts are."""
    station = served.station
    station.arm("demo-board")
    ended: list[str] = []

    def end_a_board_first(route: Route) -> None:
        if not ended:
            ended.append(station.film(board_id="SN-1"))
        route.continue_()

    page.route("**/api/v1/runs/counts*", end_a_board_first)
    page.goto(served.url)
    expect(page.locator("#verdict-word")).to_have_text("Pictures good")
    settled(page, station)
    expect(page.locator("#counts .count-ok")).to_have_text("1")
    station.film(board_id="SN-2")
    expect(page.locator("#counts .count-ok")).to_have_text("2")


def settled(page: Page, station: Any) -> None:
    """Wait until the page has shown a further event."""
    for state, word in (("arming", "Arming"), ("armed", "Ready")):
        station.state = StationState(state)
        with page.expect_response("**/api/v1/station"):
            station.publish("station", state=state)
        expect(page.locator("#state-word")).to_have_text(word)


def test_the_station_filters_the_list_and_a_file_has_it(page: Page, served: Any, tmp_path: Path) -> None:
    station = served.station
    first = station.film(board_id="=SUM(1)")
    fail(station, "SN-2")
    station.kept.mosaics.keep(first)
    figures = {"unseen_parts": 3, "sigma_px": 0.1234, "residual_px": 0.0612, "slip_percent": -1.5}
    seams = {"seam_px:0-1": 0.2, "seam_px:1-2": 0.31}
    station.kept.trends.rows.append(BoardRow(first, utc(), "demo-board", {**figures, **seams}))
    page.goto(f"{served.url}/#/boards")
    expect(page.locator("#list tbody tr")).to_have_count(2)
    shown = page.locator("#list tbody tr").last
    for name, text in FIGURES.items():
        expect(shown.locator(f"td.{name}")).to_have_text(text)
    expect(shown.locator("img")).not_to_have_js_property("naturalWidth", 0)
    expect(shown.locator("img")).to_have_js_property("naturalWidth", 72)
    expect(page.locator("#list tbody img")).to_have_count(1)
    page.set_viewport_size({"width": 800, "height": 480})
    page.locator("#list").evaluate("list => list.scrollTo(2000, 0)")
    expect(shown.locator("td.decision")).to_be_in_viewport()
    expect(shown.get_by_role("link")).to_be_in_viewport(ratio=1)
    page.set_viewport_size({"width": 1280, "height": 800})
    with page.expect_download() as saved:
        page.locator("#save").click()
    saved.value.save_as(tmp_path / "boards.csv")
    text = (tmp_path / "boards.csv").read_text(encoding="utf-8-sig")
    assert text.splitlines()[0].startswith('"started","board_id"')
    assert all(f'"{value}"' in text.splitlines()[2] for value in FIGURES.values())
    assert '"rows-lost"' in text.splitlines()[1]
    page.goto(f"{served.url}/#/board/{first}?tab=report")
    expect(page.locator("#facts")).to_contain_text("Residual of the links0.061 px")
    expect(page.locator("#facts")).to_contain_text("Seams between cameras0-1: 0.200 px, 1-2: 0.310 px")
    page.goto(f"{served.url}/#/boards")
    assert '"\'=SUM(1)"' in text
    page.get_by_label("Span").select_option("yesterday")
    expect(page.locator("#list-answer")).to_have_text("No boards match.")
    length_h = page.evaluate("""() => {
        const field = (name) => new Date(document.querySelector(`[name=${name}]`).value);
        return (field("until") - field("since")) / 3600000;
    }""")
    assert length_h in (23, 24, 25), "a day, also when summer time begins or ends"
    page.reload()
    expect(page.get_by_label("Span")).to_have_value("yesterday")
    page.get_by_label("Span").select_option("today")
    expect(page.locator("#list tbody tr")).to_have_count(2)
    expect(page.get_by_label("From", exact=True)).to_be_hidden()
    page.get_by_label("Span").select_option("other")
    page.set_viewport_size({"width": 800, "height": 480})
    edges = page.evaluate("[...document.querySelectorAll('#filters label')].map((e) => [e.scrollWidth, e.clientWidth])")
    assert all(wide <= room for wide, room in edges), "dates are not clipped"
    page.get_by_label("From", exact=True).fill("2026-01-01T00:00")
    expect(page.get_by_label("Span")).to_have_value("other")
    page.get_by_label("Verdict").select_option("failed")
    page.get_by_role("button", name="Show").click()
    expect(page.locator("#list tbody tr")).to_have_count(1)
    expect(page.locator("#list tbody td.reasons")).to_have_text(
        "Between two parts of the run there is no usable frame."
    )
    expect(page.locator("#list tbody td.reasons p")).to_have_attribute("title", "rows-lost")
    page.reload()
    expect(page.get_by_label("Verdict")).to_have_value("failed")
    page.get_by_label("Board id").fill("SN-99")
    page.get_by_role("button", name="Show").click()
    expect(page.locator("#list-answer")).to_have_text("No boards match.")


def test_reasons_are_chosen_and_shown_in_the_language_of_the_page(page: Page, served: Any) -> None:
    fail(served.station, "SN-1")
    newer = Reason(code="newer-code", message="A newer station says so.")
    served.station.finish(served.station.film(finish=False, board_id="SN-2"), Status.DEGRADED, (newer,))
    page.goto(f"{served.url}/#/boards?reason=newer-code")
    expect(page.locator("#list td.reasons")).to_have_text("newer-code")
    page.get_by_role("button", name="Deutsch").click()
    shown = page.get_by_label("Grund").locator("option:checked")
    expect(shown).to_have_text("newer-code")
    page.get_by_label("Grund").select_option("Zwischen zwei Teilen des Laufs fehlen brauchbare Einzelbilder.")
    expect(shown).to_have_attribute("title", "rows-lost")
    page.get_by_role("button", name="Zeigen").click()
    expect(page.locator("#list td.reasons")).to_have_text(
        "Zwischen zwei Teilen des Laufs fehlen brauchbare Einzelbilder."
    )
    assert page.url.endswith("?reason=rows-lost")


def wait_for_pictures(page: Page, count: int) -> None:
    """Wait until every picture is shown."""
    expect(page.locator("figure")).to_have_count(count)
    for image in page.locator("figure img").all():
        expect(image).not_to_have_js_property("naturalWidth", 0)
    expect(page.locator("figure.unloadable")).to_have_count(0)

"""One board in a real browser: parts and what is drawn over them, pictures, comparison, report, times, files."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from tests.api.held_station import HeldStation
from tests.api.web.test_boards import fail, wait_for_pictures
from tests.api.web.test_views import SIZES, wide_elements
from vaoi_station.model import Status

pytestmark = pytest.mark.browser


def test_a_board_has_its_report_its_parts_and_their_pictures(page: Page, served: Any) -> None:
    run = served.station.film(board_id="SN-1")
    served.station.kept.identities.read(run, "demo;SN-2")
    page.goto(f"{served.url}/#/board/{run}")
    expect(page.locator("#component")).to_have_value("U1")
    wait_for_pictures(page, 10)
    expect(page.locator(".outlines polygon")).to_have_count(3)
    expect(page.locator(".outlines .chosen title")).to_have_text("U1")
    expect(page.locator("#part-facts")).to_contain_text("0.020 px, 2.5 µm")
    page.locator("#component").fill("2/r1")
    page.keyboard.press("Enter")
    wait_for_pictures(page, 3)
    expect(page.locator("figure img").first).to_have_attribute("alt", "2/R1, camera 0, row 3")
    expect(page.locator(".outlines .chosen title")).to_have_text("2/R1")
    page.locator("#component").fill("X99")
    page.keyboard.press("Enter")
    expect(page.locator("#finder-answer")).to_have_text("There is no part X99.")
    page.get_by_role("tab", name="Report").click()
    expect(page.locator("#facts")).to_contain_text("10 of 12 good (1 incomplete, 1 missing), 4 rows × 3 cameras")
    expect(page.locator("#facts")).to_contain_text("armed SN-1, read SN-2: differs")
    expect(page.locator("#facts")).to_contain_text("0.400 px, 50.0 µm (2/R1)")
    expect(page.locator("#facts")).to_contain_text("0/2 – 1/2: too dark")
    gone = served.station.film(board_id="SN-2")
    served.station.release(gone)
    page.goto(f"{served.url}/#/board/{gone}")
    expect(page.locator("#pictures-note")).to_contain_text("no longer in memory")
    expect(page.locator("#zoom-note")).to_contain_text("The frames were released by the tester.")
    page.goto(f"{served.url}/#/board/unknown")
    expect(page.locator("#board-title")).to_have_text("There is no such board.")


def test_the_whole_board_does_not_wait_for_the_list_of_its_parts(page: Page, served: Any) -> None:
    """The list of 3000 parts takes longer than all tiles of the picture."""
    run, held = served.station.film(), list[Route]()

    def hold(route: Route) -> None:
        held.append(route)

    page.route("**/components?*", hold)
    with page.expect_request("**/components?*"):  # it follows the picture, which may be complete before
        page.goto(f"{served.url}/#/board/{run}")
        expect(page.locator("#zoom-view[data-mosaic]")).to_be_visible()
        page.wait_for_function("() => OpenSeadragon.getViewer('zoom-view').world.getItemAt(0).getFullyLoaded()")
    expect(page.locator(".outlines polygon")).to_have_count(0)
    assert len(held) == 1
    page.evaluate("() => { window.shown = OpenSeadragon.getViewer('zoom-view'); }")
    held[0].continue_()
    expect(page.locator(".outlines polygon")).to_have_count(3)
    expect(page.locator(".outlines .chosen title")).to_have_text("U1")
    assert page.evaluate("() => window.shown === OpenSeadragon.getViewer('zoom-view')"), "its tiles stay"


def test_a_link_reproduces_colours_drawings_part_picture_and_comparison(page: Page, served: Any) -> None:
    station = served.station
    station.lights = ("left", "right")
    first, second = station.film(board_id="SN-1"), station.film(board_id="SN-2")
    page.goto(f"{served.url}/#/board/{second}")
    wait_for_pictures(page, 10)
    page.get_by_label("Colour parts by").select_option("sigma")
    expect(page.locator(".outlines .c3 title")).to_have_text("2/R1: σ 0.400 px = 50.0 µm")
    expect(page.locator("#legend")).to_contain_text("σ in the worst view, px")
    for name, shapes in (("Frames", 11), ("Links", 13), ("Fiducials", 2), ("Residuals", 16)):
        page.get_by_role("button", name=name).click()
        expect(page.locator(f".drawn-{name.lower()} > *")).to_have_count(shapes)
    expect(page.locator("#legend")).to_contain_text("Residuals, enlarged")
    page.get_by_role("button", name="Next part").click()
    expect(page.locator("#component")).not_to_have_value("U1")
    page.locator("#component").fill("U1")
    page.keyboard.press("Enter")
    page.get_by_label("Light").select_option("left")
    wait_for_pictures(page, 5)
    page.locator("figure button").nth(1).click()
    page.get_by_label("Compare with").select_option("previous")
    expect(page.locator("#compare-answer")).to_have_text(f"Beside SN-1 ({first}).")
    page.get_by_role("button", name="1:1").click()
    expect(page.locator("#other")).to_be_visible()
    chosen = page.locator("figure.chosen img").get_attribute("alt")
    page.reload()
    wait_for_pictures(page, 5)
    expect(page.get_by_label("Colour parts by")).to_have_value("sigma")
    expect(page.locator(".drawn-residuals > *")).to_have_count(16)
    expect(page.locator("#large")).to_have_attribute("alt", chosen or "")
    expect(page.locator("#other")).to_have_attribute("src", re.compile(first))
    width = page.locator("#large").evaluate("e => e.clientWidth - e.naturalWidth / devicePixelRatio")
    assert abs(width) <= 1, "one pixel of the camera is one of the screen"


def test_lights_are_subtracted_exposures_merged_and_boards_blink(page: Page, served: Any) -> None:
    station = served.station
    station.lights = ("left", "right")
    first, second = station.film(board_id="SN-1"), station.film(board_id="SN-2")
    page.goto(f"{served.url}/#/board/{second}?light=left&minus=right&with={first}&how=blink")
    expect(page.locator("#stage-facts")).to_contain_text("minus camera")
    expect(page.locator("#with-run")).to_have_value(first)
    for _ in range(2):
        expect(page.locator("#other")).to_have_css("visibility", "hidden")
        expect(page.locator("#other")).to_have_css("visibility", "visible")
    page.get_by_role("button", name="Slider").click()
    page.get_by_label("Place of the divide").focus()
    page.keyboard.press("Home")
    for _ in range(25):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#other")).to_have_css("clip-path", "inset(0px 0px 0px 25%)")
    page.get_by_role("button", name="HDR").click()
    expect(page.locator("#stage-facts")).to_contain_text("merged of")
    page.get_by_label("Compare with").select_option("reference")
    expect(page.locator("#compare-answer")).to_have_text("This board type has no reference.")
    page.get_by_label("Compare with").select_option("run")
    page.locator("#with-run").fill(second)
    page.keyboard.press("Enter")
    expect(page.locator("#compare-answer")).to_have_text("That is this run.")
    expect(page.locator("#other")).to_be_hidden()


def test_files_are_offered_and_what_is_gone_says_why(page: Page, served: Any) -> None:
    run = served.station.film(board_id="SN-1")
    page.goto(f"{served.url}/#/board/{run}")
    page.get_by_role("tab", name="Part").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#tab-export")).to_be_visible()
    with page.expect_download() as saved:
        page.get_by_role("button", name="Components, CSV").click()
    lines = saved.value.path().read_text(encoding="utf-8-sig").splitlines()
    assert lines[1].startswith('"U1","20","20","0","2"')
    with page.expect_download() as matrices:
        page.get_by_role("link", name="Matrices, JSON").click()
    assert matrices.value.path().read_text().startswith('{"format":"vaoi-stitch"')
    gone = served.station.film(board_id="SN-2")
    served.station.release(gone)
    page.goto(f"{served.url}/#/board/{gone}?tab=export")
    expect(page.get_by_role("button", name="Whole board, TIFF")).to_be_disabled()
    expect(page.locator("#tab-export")).to_contain_text("was not kept as a recording")


def test_a_board_whose_frames_are_gone_has_its_kept_picture(page: Page, served: Any) -> None:
    run, other = served.station.film(board_id="SN-1"), served.station.film(board_id="SN-2")
    for number in (run, other):
        served.station.kept.mosaics.keep(number)
        served.station.release(number)
    page.goto(f"{served.url}/#/board/{other}?with={run}&colour=sigma")
    expect(page.locator("#zoom-note")).to_contain_text("small picture of the board that the station has kept")
    expect(page.locator("#zoom-view")).to_have_attribute("data-mosaic", "kept")
    expect(page.locator(".outlines .filled")).to_have_count(3)
    expect(page.locator("#pictures-note")).to_contain_text("no longer in memory")
    expect(page.locator("#compare-answer")).to_have_text(f"Beside SN-1 ({run}).")
    page.locator("#to-export").click()
    expect(page.get_by_role("link", name="Kept picture, JPEG")).to_be_visible()


def test_a_failed_board_opens_on_the_reasons_and_its_frames_as_they_were_filmed(
    page: Page, served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    station, stitch = served.station, served.station.stitch
    place = {"frame": [1, 0], "px": [160.0, 60.0], "score": 0.9, "frame_px": [320, 240]}

    def with_place(run: str) -> Any:
        return (found := stitch(run)).model_copy(update={"quality": found.quality | {"fiducial_places": [place]}})

    monkeypatch.setattr(station, "stitch", with_place)
    run = fail(station, "SN-47")
    page.goto(f"{served.url}/#/board/{run}")
    expect(page.locator("#first-reason")).to_have_text("Rows are lost.")
    expect(page.locator("#verdict-reasons li")).to_have_text(["Rows are lost."])
    expect(page.locator("#tabs button:visible")).to_have_text(["Report", "Timing", "Export"])
    expect(page.locator("#decisions button")).to_have_text(["Film again"])
    expect(page.locator("#zoom")).to_be_hidden()
    expect(page.locator("#raw tbody tr")).to_have_count(4)
    expect(page.locator("#raw td img")).to_have_count(11)
    expect(page.locator("#raw .missing, #raw .incomplete")).to_have_text(["incomplete: cable", "missing: cable"])
    expect(page.locator("#raw circle title")).to_have_text("like a fiducial: 0.90")
    circle, frame = (page.locator(f"#raw a:has(circle) {name}").bounding_box() for name in ("circle", "img"))
    assert circle is not None
    assert frame is not None
    assert circle["x"] + circle["width"] / 2 - frame["x"] == pytest.approx(frame["width"] / 2, abs=1)
    with page.expect_popup() as large:
        page.locator("#raw a").first.click()
    assert large.value.url.endswith(f"/runs/{run}/frames/0/0?incomplete=show&format=png")
    station.release(run)
    expect(page.locator("#raw")).to_contain_text("released by the tester. They were not kept as a recording.")


def test_the_first_reason_against_a_board_leads_to_its_place(page: Page, served: Any) -> None:
    run = fail(served.station, "SN-47", Status.DEGRADED)
    page.goto(f"{served.url}/#/board/{run}")
    expect(page.locator("#first-reason p")).to_have_text("Rows are lost.")
    expect(page.locator("#first-reason .board-picture img").first).to_be_visible()
    page.get_by_role("button", name="Show the place").click()
    expect(page.get_by_role("button", name="Frames")).to_have_attribute("aria-pressed", "true")
    page.wait_for_function("() => OpenSeadragon.getViewer('zoom-view').viewport.getBounds().width < 0.95")


def test_what_is_shown_of_a_recording_is_not_called_gone(page: Page, served: Any) -> None:
    station = served.station
    run = station.film(board_id="SN-1")
    station.filmed[run] = station.filmed[run].model_copy(update={"frames_available": False, "recording": True})
    page.goto(f"{served.url}/#/board/{run}")
    expect(page.locator("#zoom-note")).to_contain_text("on disk as a recording")
    expect(page.locator("#zoom-note")).not_to_contain_text("gone")


def show_one_board(station: HeldStation, without_chips: tuple[str, ...]) -> None:
    """Make all runs show the same board with noise of their own; of some, something else lies where its chips are."""
    for (run, camera, row), frame in station.pixels.items():
        noise = np.random.default_rng([int(run[1:]), camera, row])
        frame[:] = np.random.default_rng([camera, row]).integers(40, 200, frame.shape) + noise.integers(
            0, 6, frame.shape
        )
        if run in without_chips:
            frame[190:] = np.random.default_rng([7, camera, row]).integers(40, 200, frame[190:].shape)


def test_a_board_is_taught_as_good_and_the_parts_in_doubt_of_another_one_are_gone_through(
    page: Page, served: Any
) -> None:
    first, second, third, fourth = (served.station.film(board_id=f"SN-{n}") for n in range(4))
    show_one_board(served.station, without_chips=(first, third))
    page.goto(f"{served.url}/#/board/{first}")
    expect(page.locator("#measures-note")).to_contain_text("No good board of this type is known")
    page.get_by_role("button", name="Measure by heights").click()
    expect(page.locator("#part-facts")).to_contain_text("no good board has this part; frames alone do not tell")
    page.get_by_role("button", name="This board is good").click()
    expect(page.locator("#good-answer")).to_have_text("Kept as a good board; there is 1 of this type.")
    expect(page.locator("#measures-remarks li").first).to_contain_text("Good boards: 1. How far")
    served.station.parts.teach(fourth)
    page.goto(f"{served.url}/#/board/{second}")
    page.get_by_role("button", name="This board is good").click()
    expect(page.locator("#good-answer")).to_contain_text("Look at these parts.")
    doubt = page.locator("#good-answer a").filter(has_text=f"R1 on {first}: looks unlike others of its kind")
    doubt.first.click()
    expect(page.locator("#component")).to_have_value("R1")
    page.get_by_role("button", name="Not good after all").click()
    expect(page.locator("#good-answer")).to_contain_text("No longer a good board; 2 of this type are left.")
    served.station.parts.teach(first)
    page.goto(f"{served.url}/#/board/{third}")
    expect(page.locator("#measures-note")).to_have_text(
        "3 of 3 parts are measured, against 3 good boards. These are measures, not a judgement."
    )
    doubts = page.locator("#doubts button")
    expect(doubts).to_have_text([re.compile("^R1: looks absent"), re.compile("^2/R1: looks absent")])
    doubts.first.click()
    expect(page.locator("#component")).to_have_value("R1")
    page.keyboard.press("ArrowDown")
    expect(page.locator("#component")).to_have_value("2/R1")
    expect(doubts.last).to_be_focused()
    expect(doubts.last).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#part-facts")).to_contain_text("3 frames, 3 good boards")
    page.get_by_label("Colour parts by").select_option("presence")
    expect(page.locator(".outlines .agrees title")).to_have_text("U1: 100 %")
    expect(page.locator(".outlines .lower")).to_have_count(2)
    page.get_by_label("Colour parts by").select_option("shift")
    expect(page.locator(".outlines .c0 title")).to_have_text(re.compile("U1: .+ mm"))
    expect(page.locator(".outlines .none title").last).to_have_text("2/R1: cannot say")


def test_doubts_and_boards_are_gone_through_by_keyboard_beside_good_ones_and_limits_say_what_they_mark(
    page: Page, served: Any
) -> None:
    station = served.station
    runs = [station.film(board_id=f"SN-{n}") for n in range(4)]
    for run in runs[:2]:
        station.parts.teach(run)
    page.goto(f"{served.url}/#/board/{runs[2]}?colour=shift")
    expect(page.locator("#doubts button")).to_have_count(2)
    doubts = [text.partition(":")[0] for text in page.locator("#doubts button").all_text_contents()]
    for chosen in (*doubts, doubts[0]):
        page.keyboard.press("Alt+ArrowDown")
        expect(page.locator("#component")).to_have_value(chosen)
    page.locator("#component").fill("R1")
    page.keyboard.press("Enter")
    expect(page.locator("#beside-good")).to_have_text(re.compile(r"R1 beside that .+: r00000[12]$"))
    expect(page.locator("#trios figcaption").first).to_have_text("this board, 100 µs")
    for name in ("part", "good", "difference"):
        page.wait_for_function(f"() => document.querySelector('#trios .{name} img')?.naturalWidth > 4")
    page.locator("#limits summary").press("Enter")
    page.locator("#level").select_option("every")  # as soon as the station has answered
    page.get_by_label("Limit (empty: none)").fill("0.9")
    page.keyboard.press("Enter")
    expect(page.locator("#limit-answer")).to_have_text("It would have marked 2 parts on 1 of the latest 1 boards.")
    expect(page.locator("#limit-marks a")).to_have_text([f"{runs[2]}: R1", f"{runs[2]}: 2/R1"])
    limits = f"{served.url}/api/v1/board-types/demo-board/limits"
    assert "0.9" not in served.client.get(limits).text
    page.get_by_role("button", name="Set", exact=True).click()
    expect(page.locator("#limit-answer")).to_contain_text("Set; it applies from the next arming on.")
    assert served.client.get(limits).json()["every"] == {"presence": 0.9}
    page.keyboard.press("Alt+PageDown")
    expect(page.locator("#board-title")).to_contain_text("SN-3")
    assert page.url.endswith(f"/#/board/{runs[3]}?component=R1&colour=shift")
    expect(page.locator("#later")).to_have_count(0)
    expect(page.locator("#doubts")).to_contain_text("R1: beyond the limit: presence")
    page.keyboard.press("Alt+PageUp")
    expect(page.locator("#board-title")).to_contain_text("SN-2")
    page.get_by_label("Compare with").select_option("next")
    expect(page.locator("#compare-answer")).to_have_text(f"Beside SN-3 ({runs[3]}).")
    page.get_by_role("button", name="Side by side").click()
    expect(page.locator("#pair")).to_have_class("beside")
    mine, other = (page.locator(name).bounding_box() for name in ("#large", "#other"))
    assert mine is not None
    assert other is not None
    assert mine["x"] + mine["width"] <= other["x"]


def test_nothing_is_clipped(browser: Browser, served: Any) -> None:
    """In German, whose words are longer than those of English."""
    station = served.station
    station.lights = ("left", "right")
    station.film(board_id="SN-47-of-a-long-series")
    run = fail(station, "SN-48-of-a-long-series", Status.DEGRADED)
    station.parts.teach(run)
    context = browser.new_context(locale="de", color_scheme="dark")
    page = context.new_page()
    page.goto(f"{served.url}/#/board/{run}?colour=sigma&show=frames,links,fiducials,residuals&light=left&with=previous")
    expect(page.locator("#other")).to_be_visible()
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        for name in ("part", "report", "timing", "export"):
            page.locator(f"#to-{name}").click()
            expect(page.locator(f"#tab-{name} > *").first).to_be_visible()
            assert wide_elements(page) == [], (width, name)
            expect(page.locator(f"#to-{name}")).to_be_in_viewport(ratio=1)
            expect(page.locator(f"#tab-{name} > *").first).to_be_in_viewport()
        page.locator("main").evaluate("e => e.scrollTo(0, 0)")
        expect(page.locator("#tabs")).to_be_in_viewport(ratio=1)
        assert page.locator("#zoom-view").evaluate("e => e.clientHeight") >= 240, "whatever the legend says"
    page.locator("#to-report").click()
    reason = page.locator("#verdict-reasons li")
    expect(reason).to_contain_text("Zwischen zwei Teilen des Laufs fehlen brauchbare Einzelbilder.")
    expect(reason.locator("[lang=en]")).to_be_hidden()
    reason.locator("summary").press("Enter")
    expect(reason.locator("[lang=en]")).to_have_text("Rows are lost.")
    context.close()

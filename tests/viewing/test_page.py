"""The live page in a browser: marks, best focus, hold."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest
from playwright.sync_api import Page, expect, sync_playwright

from tests.needs import chromium
from vaoi_station.api.web_server import WebServer, open_listener
from vaoi_station.config import StationConfig, read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.simulation import calibration_board, scenario_path
from vaoi_station.viewing.app import create_app
from vaoi_station.viewing.latest_frames import LatestFrames
from vaoi_station.viewing.mark_spec import MarkSpec

pytestmark = pytest.mark.browser
PATIENCE_MS = 20_000


@pytest.fixture
def latest() -> LatestFrames:
    return LatestFrames([MarkSpec("cross", 24.0, light=False, expected=4), None])


@pytest.fixture
def browser() -> Iterator[Page]:
    """A page in chromium; errors on its console fail the test."""
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: complaints.append(str(e)))
        yield page
        browser.close()
    assert complaints == []


@pytest.fixture
def page(browser: Page, latest: LatestFrames, make_config: Callable[..., StationConfig]) -> Iterator[Page]:
    """The page with frames that a test provides."""
    with open_listener("127.0.0.1", 0, "test") as socket_:
        server = WebServer(create_app(make_config(), latest, ["Armed."]), socket_, threading.Event().set)
        server.start()
        browser.goto(server.address)
        yield browser
        browser.goto("about:blank")
        server.stop()
        server.check()


def test_new_frames_are_shown(page: Page, latest: LatestFrames, painter: Any) -> None:
    expect(page.locator("#state")).to_have_text("Waiting for the first frame.")
    latest.put(0, "001", 2, painter.marks())
    first = page.locator(".camera").nth(0)
    expect(first.locator(".mark")).to_have_count(4, timeout=PATIENCE_MS)
    expect(first.locator("h2")).to_contain_text("run 001, row 2")
    expect(first.locator("dl")).to_contain_text("4 of 4")
    expect(page.locator("#state")).to_have_text("1 cameras have not sent a frame yet.")
    latest.put(1, "001", 2, painter.tilted_board(2.0, size=(320, 240)))
    second = page.locator(".camera").nth(1)
    expect(second.locator(".remarks")).to_contain_text("blurred by", timeout=PATIENCE_MS)
    expect(second.locator(".sharpness-words .soft")).to_have_count(9)
    expect(page.locator("#notices")).to_contain_text("Armed.")


def test_the_best_focus_is_kept_and_hold_stops_updates(page: Page, latest: LatestFrames, painter: Any) -> None:
    sharp = painter.marks()
    latest.put(0, "001", 0, sharp)
    words = page.locator(".words")
    expect(words).to_contain_text("100 % of the best", timeout=PATIENCE_MS)
    latest.put(0, "001", 1, cv2.GaussianBlur(sharp, (0, 0), 3.0))
    expect(words).not_to_contain_text("100 % of the best", timeout=PATIENCE_MS)
    page.get_by_role("button", name="Hold").click()
    with page.expect_response(lambda r: "number=3" in r.url):
        latest.put(0, "001", 2, sharp)
    expect(page.locator("h2")).to_contain_text("row 1")
    page.get_by_role("button", name="Continue").click()
    expect(page.locator("h2")).to_contain_text("row 2", timeout=PATIENCE_MS)
    expect(words).to_contain_text("100 % of the best")


def test_the_calibration_board_is_filmed_without_a_passing_board(
    browser: Page, viewing: Callable[..., Any], tmp_path: Path
) -> None:
    toml, twin = write_station_files(scenario_path("small"), tmp_path)
    (tmp_path / "layout.json").write_text(json.dumps(calibration_board.layout(twin)))
    with viewing(read_config(toml), tmp_path, "--rate", "5", "--layout", str(tmp_path / "layout.json")) as (address, _):
        browser.goto(address)
        for camera in (0, 1):
            card = browser.locator(".camera").nth(camera)
            expect(card.locator(".mark")).to_have_count(4, timeout=PATIENCE_MS)
            expect(card.locator("h2")).to_contain_text(re.compile(r"run \d+, row 0"))
        first = browser.locator("h2").nth(0).inner_text()
        expect(browser.locator("h2").nth(0)).not_to_have_text(first, timeout=PATIENCE_MS)
        expect(browser.locator("#notices")).to_contain_text("5 pulses per second, independent of the light barrier.")
        browser.goto("about:blank")

"""Beside the last board the line's neighbours, and a board that a person says is out."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.hermes.station import PlayedStation, free_port
from vaoi_station.runs.states.schemas import BoardBehind, ContactsStatus


@pytest.mark.browser
def test_a_waiting_board_is_said_to_be_out_by_two_presses(page: Page, tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    page.set_viewport_size({"width": 1920, "height": 1080})
    with PlayedStation(tmp_path, listen=address).running() as played:
        served = Served(HeldStation(), line=played.service)
        try:
            page.goto(served.url)
            expect(page.locator("#neighbour-list")).to_contain_text(f"next machine ({address}): not connected")
            played.film()
            expect(page.locator("#waiting-boards li")).to_contain_text("waits for the next machine")
            page.locator("#waiting-boards button").click()
            expect(page.locator("#waiting-boards button")).to_have_text("Really out? Press again")
            page.locator("#waiting-boards button").click()
            expect(page.locator("#waiting-boards li")).to_have_count(0)
            assert not played.service.status().boards
        finally:
            served.stop()


@pytest.mark.browser
def test_a_station_without_neighbours_shows_none(page: Page) -> None:
    page.set_viewport_size({"width": 1920, "height": 1080})
    served = Served(HeldStation())
    try:
        with page.expect_response("**/api/v1/neighbours"):
            page.goto(served.url)
        expect(page.locator("#neighbours")).to_be_hidden()
    finally:
        served.stop()


@pytest.mark.browser
@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (800, 480), (390, 844)])
def test_contacts_show_why_nothing_moves_and_a_board_that_a_person_took_out(
    page: Page, width: int, height: int
) -> None:
    page.set_viewport_size({"width": width, "height": height})
    station = HeldStation()
    board = BoardBehind(name="r000001", failed=True)
    station.contacts_shown = ContactsStatus(
        known=True, available=True, failed=False, next_ready=False, offered="failed", boards=(board,)
    )
    served = Served(station)
    try:
        page.goto(served.url)
        expect(page.locator("#neighbour-list")).to_contain_text("upstream (SMEMA): a board waits")
        expect(page.locator("#neighbour-list")).to_contain_text("not ready, offered as failed")
        waiting = page.locator("#waiting-boards")
        expect(waiting).to_contain_text("r000001 waits for the next machine, as a failed board")
        waiting.get_by_role("button").click()
        waiting.get_by_role("button").click()
        expect(waiting).to_be_empty()
    finally:
        served.stop()

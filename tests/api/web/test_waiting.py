"""The page of a station that cannot be started yet, in a real browser: it becomes the operator's view by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Browser, expect

from tests.api.web.test_views import examine
from vaoi_station.api.routes.waiting_page import WaitingPage
from vaoi_station.api.web_server import open_listener
from vaoi_station.errors import DeviceError

pytestmark = pytest.mark.browser


def test_a_browser_waits_with_the_station(browser: Browser, station: Any, serve: Callable[..., Any]) -> None:
    page = browser.new_page(viewport={"width": 800, "height": 480})
    with open_listener("127.0.0.1", 0, "test") as listener:
        port = listener.getsockname()[1]
        with WaitingPage(listener, ["127.0.0.1"]) as waiting:
            waiting.report(DeviceError("There is no memory.", action="Lower ring.runs.", code="ring-too-large"))
            page.goto(f"http://127.0.0.1:{port}/")
            expect(page.locator("h1").first).to_have_text("Not started")
            expect(page.get_by_text("Baugruppen zurückhalten. Administrator rufen.")).to_be_visible()
            expect(page.locator(".cause")).to_have_text("There is no memory. Lower ring.runs.")
            assert page.evaluate("[...document.querySelectorAll('h1, p')].every((e) => e.scrollWidth <= e.clientWidth)")
            cause = page.locator(".cause").bounding_box()
            assert cause is not None
            assert cause["y"] + cause["height"] <= 480
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)
                assert examine(page) == [], scheme
            waiting.report(DeviceError("The disk is full.", action="Free space.", code="storage-full"))
            expect(page.locator(".cause")).to_have_text("The disk is full. Free space.")
    again = serve(station, port)
    expect(page.locator("#state-word")).to_have_text("Not armed")
    page.close()
    again.stop()

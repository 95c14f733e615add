"""The login of the page in a real browser: a wrong key, a key that is revoked while the page is open, logout, TLS."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from playwright.sync_api import Page, expect

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.api.web.test_views import SCHEMES, SIZES, examine
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

pytestmark = pytest.mark.browser


class Closed(NamedTuple):
    """A station that asks for a key on loopback too, and its keys."""

    served: Served
    keys: KeyFile
    access: AccessControl


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[Closed]:
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    access = AccessControl(keys, audit, open_loopback=False)
    served = Served(HeldStation(), access=access)
    yield Closed(served, keys, access)
    served.stop()
    audit.close()


def log_in(page: Page, url: str, secret: str) -> None:
    page.goto(url)
    expect(page.get_by_role("heading", name="This station asks for a key")).to_be_visible()
    page.get_by_label("Key").fill(secret)
    page.get_by_role("button", name="Log in").click()


def fits(page: Page) -> None:
    """Assert that the login is wholly shown at every size, and that axe finds nothing in light and dark."""
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        clipped = page.evaluate(
            "[...document.querySelectorAll('#login, #login *')].filter((e) => e.scrollWidth > e.clientWidth + 1)"
            ".map((e) => e.id || e.tagName)"
        )
        assert clipped == [], width
        expect(page.locator("#login button")).to_be_in_viewport(ratio=1)
    for scheme in SCHEMES:
        page.emulate_media(color_scheme=scheme)
        assert examine(page) == [], scheme


def test_a_wrong_key_is_refused_and_the_right_one_leads_to_the_page(page: Page, closed: Closed) -> None:
    log_in(page, closed.served.url, "vaoi_0123456789ab_wrong")
    expect(page.locator("#login-answer")).to_have_text(re.compile("This key is not valid"))
    expect(page.locator("main")).to_be_hidden()
    expect(page.locator("#stale")).to_be_hidden()
    fits(page)
    page.evaluate("localStorage.setItem('vaoi-language', 'de')")
    page.reload()
    expect(page.locator("#login")).to_be_visible()
    fits(page)
    page.evaluate("localStorage.setItem('vaoi-language', 'en')")
    page.reload()
    page.get_by_label("Key").fill(closed.keys.create("operator", ["operate"]).secret)
    page.keyboard.press("Enter")
    expect(page.locator("#state-word")).to_have_text("Not armed")
    expect(page.locator("#login")).to_have_count(0)
    page.select_option("#board-type", "demo-board")
    page.locator("#arm").click()
    expect(page.locator("#state-word")).to_have_text("Ready")
    page.reload()  # the cookie is kept
    expect(page.locator("#state-word")).to_have_text("Ready")


def test_a_login_ends_by_logout_also_for_its_cookie_and_when_its_key_is_revoked(page: Page, closed: Closed) -> None:
    log_in(page, closed.served.url, closed.keys.create("reader", ["read"]).secret)
    expect(page.locator("#state-word")).to_have_text("Not armed")
    (cookie,) = page.context.cookies()
    assert cookie["httpOnly"]
    assert cookie["sameSite"] == "Strict"
    page.select_option("#board-type", "demo-board")
    page.locator("#arm").click()
    expect(page.locator("#answer")).to_have_text(re.compile("needs the scope operate"))
    page.get_by_role("link", name="Log out").click()
    expect(page.locator("#login")).to_be_visible()
    assert page.context.cookies() == []
    assert closed.access.sessions.key_of(cookie["value"], closed.keys.entries()) is None
    log_in(page, closed.served.url, closed.keys.create("operator", ["operate"]).secret)
    expect(page.locator("#state-word")).to_have_text("Not armed")
    closed.keys.revoke("operator")
    expect(page.locator("#login")).to_be_visible()
    expect(page.locator("main")).to_be_hidden()

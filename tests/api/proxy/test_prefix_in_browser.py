"""The page under a path of a reverse proxy, in a real browser: no request leaves the path, none fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Page, expect

from tests.api.proxy.conftest import Prefixed
from tests.api.web.test_login import log_in
from tests.api.web.test_views import VIEWS

pytestmark = pytest.mark.browser


@pytest.fixture(params=["stripped", "unchanged", "stripped, several names", "unchanged, several names"])
def prefixed(request: pytest.FixtureRequest, start: Callable[[str], Prefixed]) -> Prefixed:
    found = start(request.param)
    trends: Any = found.station.kept.trends
    if not trends.rows:
        trends.fill(150)
    return found


@pytest.fixture
def watched(page: Page, prefixed: Prefixed) -> Iterator[list[str]]:
    """The paths of all requests of a page; at its end no request has failed or has left the prefix."""
    paths, failed, refused = list[str](), list[str](), list[str]()
    page.on("request", lambda request: paths.append(urlsplit(request.url).path))
    # A picture or a stream that the page no longer needs is aborted.
    page.on("requestfailed", lambda request: None if "ABORTED" in f"{request.failure}" else failed.append(request.url))
    page.on("response", lambda reply: refused.append(reply.url) if reply.status >= 400 else None)
    yield paths
    assert failed == []
    # The page asks also for what a board may not have, such as a kept picture or a reference.
    for url in refused:
        assert prefixed.client.get(url).json()["code"] not in ("no-route", "no-key", "missing-scope", "malformed"), url
    assert [path for path in paths if not path.startswith(f"{prefixed.prefix}/")] == []


def test_every_view_is_complete(page: Page, prefixed: Prefixed, watched: list[str]) -> None:
    log_in(page, f"{prefixed.url}/", prefixed.secret)
    expect(page.locator("#login")).to_be_hidden()  # a page that is left before has no cookie
    for name, complete in VIEWS.items():
        page.goto(prefixed.url + name)
        page.reload()  # an address that differs behind # only is no new page
        expect(page.locator(complete).first).to_be_visible()
    assert f"{prefixed.prefix}/api/v1/events" in watched


def test_a_board_is_zoomed_and_its_files_are_offered(page: Page, prefixed: Prefixed, watched: list[str]) -> None:
    run = prefixed.station.film(board_id="SN-1")
    log_in(page, f"{prefixed.url}/", prefixed.secret)
    expect(page.locator("#login")).to_be_hidden()  # a page that is left before has no cookie
    page.goto(f"{prefixed.url}/#/board/{run}?component=U1")
    page.reload()
    expect(page.locator('button img[alt*="amera"]').first).to_be_visible()
    page.wait_for_function(
        "() => performance.getEntriesByType('resource').some((e) => e.name.includes('board_files/'))"
    )
    loaded = page.evaluate(
        "[...document.images].filter((image) => image.complete && image.src).map((i) => i.naturalWidth)"
    )
    assert loaded
    assert all(loaded)
    assert any("vendor/openseadragon" in path for path in watched)
    page.goto(f"{prefixed.url}/#/board/{run}?tab=export")
    page.reload()
    offered = page.locator('#view a[href*="/api/v1/"]').filter(visible=True)
    expect(offered.first).to_be_visible()
    for link in offered.all():
        address = str(link.get_attribute("href"))
        assert urlsplit(address).path.startswith(f"{prefixed.prefix}/api/v1/"), address


def test_the_line_is_armed_and_a_new_board_is_shown(page: Page, prefixed: Prefixed, watched: list[str]) -> None:
    log_in(page, f"{prefixed.url}/", prefixed.secret)
    expect(page.locator("#login")).to_be_hidden()  # a page that is left before has no cookie
    page.select_option("#board-type", "demo-board")
    page.locator("#arm").click()
    expect(page.locator("#state-word")).to_have_text("Ready")
    prefixed.station.film(board_id="SN-of-the-event")
    expect(page.get_by_text("SN-of-the-event").first).to_be_visible()
    assert prefixed.client.post(f"{prefixed.prefix}/api/v1/station/disarm").status_code == 200
    expect(page.locator("#state-word")).to_have_text("Not armed")


def test_every_page_of_set_up_is_complete(page: Page, prefixed: Prefixed, watched: list[str]) -> None:
    log_in(page, f"{prefixed.url}/", prefixed.secret)
    expect(page.locator("#login")).to_be_hidden()  # a page that is left before has no cookie
    page.goto(f"{prefixed.url}/#/setup")
    page.reload()
    expect(page.locator("#view h2").first).to_be_visible()
    links = page.locator('#view a[href^="#/setup/"]')
    addresses = sorted({str(link.get_attribute("href")) for link in links.all()})
    assert len(addresses) >= 4
    for address in addresses:
        page.goto(f"{prefixed.url}/{address}")
        page.reload()
        expect(page.locator("#view :is(h2, h3)").first).to_be_visible()
        page.wait_for_load_state("load")


def test_the_interface_is_documented_with_addresses_below_the_path(
    page: Page, prefixed: Prefixed, watched: list[str]
) -> None:
    page.goto(f"{prefixed.url}/docs")
    expect(page.locator(".opblock").first).to_be_visible()
    expect(page.locator(".servers option")).to_have_text(f"{prefixed.prefix} - The station that serves this document.")

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


@pytest.fixture(params=["unchanged", "stripped, several names"])
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
        if name == "/#/board/r000002":
            continue  # the page of a failed board: a failed board would hold the line of the other tests
        page.goto(prefixed.url + name)
        page.reload()  # an address that differs behind # only is no new page
        expect(page.locator(complete).first).to_be_visible()
    assert f"{prefixed.prefix}/api/v1/events" in watched


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

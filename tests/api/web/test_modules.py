"""What the page needs is asked for at once, not as one module names the next; the picture of a board comes first."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Request, Route, expect

from vaoi_station.api.pages import WEB

IMPORT = re.compile(r'^(?:import|export) [^;]*?from "(.+?)";', re.MULTILINE)


def modules_of(first: str) -> set[str]:
    """Return a module below the page's directory, and all that it imports, in any depth."""
    found, left = set[str](), [WEB / first]
    while left:
        module = left.pop()
        name = str(module.relative_to(WEB))
        if name not in found:
            found.add(name)
            left += [Path(module.parent, other).resolve() for other in IMPORT.findall(module.read_text())]
    return found


class Requests:
    """The paths that a page asks for."""

    def __init__(self, page: Page) -> None:
        self._page, self.paths = page, list[str]()
        page.on("request", self._note)

    def _note(self, request: Request) -> None:
        self.paths.append(request.url.partition("//")[2].partition("/")[2].partition("?")[0])

    def wait_for(self, *ends: str) -> None:
        """Wait until a path was asked for that has each of these ends."""
        while missing := [end for end in ends if not any(path.endswith(end) for path in self.paths)]:
            assert self._page.wait_for_event("request"), missing


class Held:
    """Requests of a pattern that are not answered before `release`."""

    def __init__(self, page: Page, pattern: str) -> None:
        self._waiting, self._released = list[Route](), False

        def hold(route: Route) -> None:
            if self._released:
                route.continue_()
            else:
                self._waiting.append(route)

        page.route(pattern, hold)

    def release(self) -> None:
        """Let the requests go on that have come, and those that come later."""
        self._released = True
        for route in self._waiting:
            route.continue_()


@pytest.mark.browser
def test_modules_do_not_wait_for_those_that_import_them(page: Page, served: Any) -> None:
    """Each depth of the imports would be a round of requests that waits for the one before."""
    asked, held = Requests(page), Held(page, "**/web/app.js")
    page.goto(served.url, wait_until="commit")
    asked.wait_for(*modules_of("app.js"), "texts/en.js")
    held.release()
    expect(page.locator("#state-word")).to_have_text("Not armed")
    assert not any(path.endswith("/de.js") for path in asked.paths), "texts of another language"

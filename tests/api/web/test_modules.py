"""What the page needs is asked for at once, not as one module names the next; the picture of a board comes first."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Request, Route, expect

from vaoi_station.api.pages import WEB

IMPORT = re.compile(r'^(?:import|export) [^;]*?from "(.+?)";', re.MULTILINE)
LIBRARY = "vendor/openseadragon/openseadragon.min.js"


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


def listed(name: str) -> list[str]:
    """Return the files of a list of `ahead.js`."""
    (found,) = re.findall(rf"\b{name}(?: =|:) \[(.+?)\]", (WEB / "ahead.js").read_text(), re.DOTALL)
    return re.findall(r'"(.+?)"', found)


def test_the_page_names_all_modules_of_its_frame() -> None:
    linked = re.findall(r'<link rel="modulepreload" href="web/(.+?)">', (WEB / "index.html").read_text())
    assert sorted(linked) == sorted(modules_of("app.js") - {"app.js", "ahead.js"})


def test_all_files_of_the_view_of_a_board_are_asked_for_ahead() -> None:
    assert sorted(listed("BOARD")) == sorted({*modules_of("board/board.js") - modules_of("app.js"), LIBRARY})


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


@pytest.mark.browser
def test_the_view_of_a_board_does_not_wait_for_the_login(page: Page, served: Any) -> None:
    asked, held, run = Requests(page), Held(page, "**/api/v1/session"), served.station.film()
    page.goto(f"{served.url}/#/board/{run}")
    asked.wait_for(LIBRARY, *modules_of("board/board.js"))
    assert not any(path.startswith("api/v1/runs") for path in asked.paths)
    held.release()
    expect(page.locator("#zoom-view[data-mosaic]")).to_be_visible()


@pytest.mark.browser
def test_the_picture_of_a_board_waits_for_neither_state_nor_list(page: Page, served: Any) -> None:
    """The run and its mosaics are asked for together, before the view has come, and tiles as soon as all are there."""
    run = served.station.film()
    asked, state, modules = Requests(page), Held(page, "**/api/v1/station"), Held(page, "**/web/board/*.js")
    runs, lists = (Held(page, f"**/api/v1/runs/*{rest}") for rest in ("?figures=true", "/mosaics"))
    page.goto(f"{served.url}/#/board/{run}")
    asked.wait_for(f"runs/{run}", "/mosaics")
    modules.release()
    runs.release()
    lists.release()
    asked.wait_for(".jpg")
    state.release()
    expect(page.locator("#zoom-view[data-mosaic]")).to_be_visible()
    assert asked.paths.count("api/v1/session") == 1
    assert sum(path.endswith("/mosaics") for path in asked.paths) == 1
    assert not any(path.endswith(".dzi") for path in asked.paths), "the list says the same"
    other = served.station.film()
    page.goto(f"{served.url}/#/board/{other}")
    asked.wait_for(f"runs/{other}/mosaics")


@pytest.mark.browser
def test_the_lists_of_a_board_follow_its_picture(page: Page, served: Any) -> None:
    """They take the station as long as all tiles of the picture, and would be computed beside them."""
    run = served.station.film()
    asked, tiles = Requests(page), Held(page, "**/*_files/**")
    page.goto(f"{served.url}/#/board/{run}")
    asked.wait_for(".jpg", "/components", "/overlay")  # without the tiles, after a limited time
    first = next(n for n, path in enumerate(asked.paths) if path.endswith(".jpg"))
    assert not any(path.endswith(("/components", "/overlay")) for path in asked.paths[:first])
    tiles.release()
    expect(page.locator("#component")).to_have_value("U1")

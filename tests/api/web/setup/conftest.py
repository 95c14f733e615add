"""A station whose imports are made in this process, and the measure of what does not fit on a page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.api.conftest import Served
from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from tests.api.routes.test_previews import import_here
from tests.api.web.test_views import SIZES, WIDE, examine, unreached
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.routes import board_data
from vaoi_station.files.access_keys import KeyFile

TELEPHONE = 390
"""Width of its screen, px."""
CLIPPED = """() => [...document.querySelectorAll(".setup, .setup *")].filter((e) => {
    const style = getComputedStyle(e);
    return e.checkVisibility() && !e.closest("svg, td, th") && style.display !== "inline"
        && !e.matches(".wizard, .wizards, .file, pre, input, select, option, textarea, img")
        && (e.scrollWidth > e.clientWidth + 1
            || ((style.overflowY !== "visible" || e.matches(".answer")) && e.scrollHeight > e.clientHeight + 8));
}).map((e) => `${e.tagName} ${e.id || e.className}: ${e.textContent.slice(0, 40)}`)
    .concat([...document.querySelectorAll("main, .wizard")].filter((e) => e.scrollWidth > e.clientWidth + 1)
        .map((e) => `wide: ${e.className}`))"""
"""The elements of the page whose contents do not fit. What scrolls downwards on purpose is left out."""

Fits = Callable[..., None]


@pytest.fixture
def keys(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys.json")


@pytest.fixture
def engineer(
    request: pytest.FixtureRequest, tmp_path: Path, keys: KeyFile, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Served]:
    """A station with keys, on whose own machine everything except the scope admin is permitted.

    Its parameter: whether station.toml states the nominal views of the cameras.
    """
    monkeypatch.setattr(board_data, "import_limited", import_here)
    audit = AuditLog(tmp_path / "audit.jsonl")
    access = AccessControl(keys, audit)
    served = Served(HeldStation(), access=access, files=setup_files(tmp_path, getattr(request, "param", True)))
    served.access = access  # type: ignore[attr-defined]
    yield served
    served.stop()
    audit.close()


@pytest.fixture
def admin(page: Page, engineer: Served, keys: KeyFile) -> str:
    """Log the page in with the scope admin; the address of the station."""
    page.goto(engineer.url)
    secret = keys.create("ada", ["admin", "teach", "operate"]).secret
    page.evaluate(
        """key => fetch("/api/v1/session", {method: "POST", headers: {"Content-Type": "application/json"},
                                            body: JSON.stringify({key})})""",
        secret,
    )
    return engineer.url


@pytest.fixture
def fits(page: Page) -> Fits:
    """Return a function that asserts that nothing of the shown page is clipped, at all sizes and in both languages.

    Axe examines the page too: light in English, dark in German.
    """

    def check(name: str, ready: str, step: Callable[[], Any] = lambda: None) -> None:
        for language in ("en", "de"):
            page.emulate_media(color_scheme="dark" if language == "de" else "light")
            page.evaluate("language => localStorage.setItem('vaoi-language', language)", language)
            page.reload()
            expect(page.locator(ready).first).to_be_visible()
            step()
            for width, height in SIZES:
                page.set_viewport_size({"width": width, "height": height})
                # On a telephone tables, and texts in fields, scroll by themselves, so that the page does not.
                wide = page.evaluate(CLIPPED if width > TELEPHONE else WIDE)
                assert [e for e in wide if e != "INPUT"] == [], (name, language, width)
            assert examine(page) == [], (name, language)
            assert language == "de" or unreached(page) == [], name
        page.emulate_media(color_scheme="light")
        page.evaluate("localStorage.setItem('vaoi-language', 'en')")
        page.set_viewport_size({"width": 1280, "height": 800})
        page.reload()
        expect(page.locator(ready).first).to_be_visible()

    return check

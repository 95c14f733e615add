"""A real browser shows the report without requests or errors, and with every drawing."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from tests.needs import chromium
from vaoi_station.reporting import StitchedRun, write_report

pytestmark = pytest.mark.browser


def test_browser_sends_no_request_and_logs_no_error(stitched: StitchedRun, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(path, stitched)
    asked: list[str] = []
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.on("request", lambda r: asked.append(r.url.split(",")[0]))
        page.on("console", lambda m: complaints.append(m.text))
        page.on("pageerror", lambda e: complaints.append(str(e)))
        page.goto(path.as_uri())
        boxes = page.eval_on_selector_all(
            "main svg", "all => all.map(s => [s.getBoundingClientRect().width, s.getBoundingClientRect().height])"
        )
        wide = page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        verdict = page.inner_text(".verdict")
        browser.close()
    assert [a for a in asked if not a.startswith("data:image/jpeg")] == [path.as_uri()]
    assert complaints == []
    assert len(boxes) > 10
    assert all(w > 20 and h > 20 for w, h in boxes)
    assert wide, "the page itself never scrolls sideways"
    assert verdict == "ok"

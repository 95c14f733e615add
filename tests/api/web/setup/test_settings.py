"""Settings in a real browser: station.toml as a form, its faults by field, the lines that change, saved or taken."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from vaoi_station.config import read_config

pytestmark = pytest.mark.browser


def _open(page: Page, title: str) -> Any:
    table = page.locator("details.table-of", has=page.get_by_text(title, exact=True))
    table.locator("summary").focus()
    page.keyboard.press("Enter")
    return table


def test_a_changed_setting_is_checked_shown_and_saved(
    page: Page, engineer: Any, admin: str, fits: Any, tmp_path: Path
) -> None:
    path = tmp_path / "station.toml"
    page.goto(f"{admin}/#/setup/settings")
    expect(page.get_by_text("Nothing is changed.")).to_be_visible()
    line = _open(page, "[line]")
    tail = line.get_by_label("tail_s, s")
    expect(tail).to_have_value("0.48")
    tail.fill("-1")
    line.get_by_label("trigger_period_s, s").fill("soon")
    page.keyboard.press("Tab")
    expect(page.locator(".answer.refused")).to_have_text("trigger_period_s is “soon”; it must be a number.")
    line.get_by_label("trigger_period_s, s").fill("0,0001")
    line.get_by_label("pacing").select_option("encoder")
    # All faults at once, each at its field; a press leads there.
    expect(page.locator(".settings-side .faults button")).to_have_count(1)
    expect(line.locator(".fault:visible")).to_contain_text("greater than or equal to 0")
    expect(tail).to_have_attribute("aria-invalid", "true")
    page.locator(".settings-side .faults button").press("Enter")
    expect(tail).to_be_focused()
    tail.fill("0.5")
    line.get_by_label("pacing").select_option("")
    line.get_by_label("trigger_period_s, s").fill("0.11")
    page.keyboard.press("Tab")
    expect(page.locator(".settings-side .faults button")).to_have_count(0)
    expect(page.locator(".diff .added")).to_have_text(
        [re.compile(r"\+trigger_period_s = 0\.11"), re.compile(r"\+tail_s = 0\.5")]
    )
    page.locator("#save-settings").focus()
    page.keyboard.press("Enter")
    expect(page.locator(".answer.done")).to_contain_text("It is in force after a restart: sudo vaoi check-config")
    expect(page.locator(".warnings").first).to_contain_text("line.trigger_period_s, line.tail_s")
    assert read_config(path).line.tail_s == 0.5
    # Another person changes the file: nothing is overwritten, and the change can be made again.
    path.write_text(path.read_text() + "# another person\n")
    page.get_by_label("workers").fill("3")
    page.keyboard.press("Tab")
    page.locator("#save-settings").click()
    expect(page.locator(".answer.refused")).to_contain_text("has changed since it was read")
    page.get_by_role("button", name="Read the file again").click()
    page.locator("#save-settings").click()
    expect(page.locator(".answer.done")).to_contain_text("Written")
    assert "workers = 3" in path.read_text()
    assert "# another person" in path.read_text()


def test_tables_are_added_and_removed_and_a_protected_file_is_taken(
    page: Page, engineer: Any, admin: str, fits: Any, tmp_path: Path
) -> None:
    folder, read = tmp_path / "etc", "**/api/v1/settings"
    page.goto(f"{admin}/#/setup/settings")
    page.get_by_role("button", name="Add [[cameras]]").press("Enter")
    camera = page.locator("details.table-of", has_text="[[cameras]] 3")
    for name, value in (("name", "fourth"), ("width, ", ""), ("exposure_us", "100")):
        if value:
            camera.get_by_label(name).first.fill(value)
    page.keyboard.press("Tab")
    # What the new table still needs is stated at its fields.
    expect(camera.locator(".fault:visible")).to_have_text(["Field required", "Field required"])
    camera.get_by_label("width").fill("320")
    camera.get_by_label("height").fill("240")
    page.get_by_label("Name", exact=True).fill("ring")
    page.get_by_role("button", name="Add [controller.lights.NAME]").click()
    light = page.locator("details.table-of", has_text="[controller.lights.ring]")
    light.get_by_label("channels").fill("[0, 1]")
    light.get_by_label("on_us").fill("80")
    page.keyboard.press("Tab")
    expect(page.locator(".settings-side .faults button")).to_have_count(0)
    first = _open(page, "[[cameras]] 0: cam0")
    first.get_by_role("button", name="Remove this table").click()
    expect(page.locator(".diff")).to_contain_text('-name = "cam0"')
    page.locator("#save-settings").click()
    expect(page.locator(".answer.done")).to_contain_text("Written")
    config = read_config(tmp_path / "station.toml")
    assert [c.name for c in config.cameras] == ["cam1", "cam2", "fourth"]
    assert config.controller.lights["ring"].channels == (0, 1)
    assert not folder.exists()

    def protected(route: Any) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json={**answer.json(), "writable": False})

    # The unit of the service protects the file; tests/api/setup/test_settings.py has a folder that is.
    page.route(read, protected)
    page.reload()
    expect(page.locator(".warnings").first).to_contain_text("The service may not write this file")

    def change() -> None:
        page.locator("#setting-workers").fill("4")
        page.keyboard.press("Tab")
        expect(page.locator(".diff .added")).to_have_text([re.compile(r"\+workers = 4")])
        page.evaluate("document.querySelectorAll('details.table-of').forEach((e) => { e.open = true; })")
        expect(page.locator("[id='setting-visibility.views']")).to_be_visible()

    fits("settings", "#setting-workers", change)
    change()
    expect(page.locator("#save-settings")).to_have_count(0)
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the new file").click()
    assert "workers = 4" in download.value.path().read_text()

"""Cards of cameras in a real browser: newest frame, sharpness, histogram, state, drift, findings of the doctor."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

import pytest
from playwright.sync_api import Page, expect

from tests.api.web.test_views import SIZES, WIDE, examine
from vaoi_station.api.routes.doctor import Examination, Examinations
from vaoi_station.config import KeepConfig
from vaoi_station.doctor import Machine, Report, camera_checks, controller_checks, machine_checks, storage_checks
from vaoi_station.doctor.finding import fault, warning
from vaoi_station.runs.states.schemas import CameraPtpStatus, CameraRecoveryStatus

pytestmark = pytest.mark.browser
PICTURES = os.environ.get("VAOI_PICTURES")
FOCUS_PX = "() => parseFloat(getComputedStyle(document.querySelector('#trial-focus b')).fontSize)"
"""Found and measured in one call: every frame replaces the element."""
FINDING = {
    "check": "cameras",
    "subject": "cam2",
    "level": "warning",
    "message": "12 packets lost.",
    "action": "Change the cable.",
}


def test_each_camera_has_a_card_that_follows_its_frames(
    page: Page, served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = {
        "created": "2026-01-01T00:00:00Z",
        "worst": "warning",
        "findings": [FINDING, FINDING | {"level": "ok", "action": ""}],
    }
    monkeypatch.setattr(Examinations, "examine", AsyncMock(return_value=Examination.model_validate(report)))
    page.goto(f"{served.url}/#/cameras")
    cards = page.locator(".camera-card")
    expect(cards).to_have_count(3)
    expect(cards.nth(0).locator(".camera-picture")).to_have_text("No frame in memory. Let a board pass.")
    served.station.film(board_id="SN-1")
    for card in cards.all():
        expect(card.locator("img")).not_to_have_js_property("naturalWidth", 0)
        expect(card.locator(".sharpness-words span")).to_have_count(9)
        expect(card.locator(".camera-focus b")).to_have_text(re.compile(r"0\.\d\d"))
        expect(card.locator(".histogram rect")).to_have_count(64)
        expect(card.locator("dl")).to_contain_text("Mbit/s")
    expect(cards.nth(1).locator("dl")).to_contain_text("moved by 9.40 px")
    served.station.recovering[0] = CameraRecoveryStatus(step="reset", why="silent", at="2026-01-01T12:00:00Z")
    served.station.ptp |= {
        0: CameraPtpStatus(state="Slave", synchronised=True, offset_ns=-240, apart_us=3200.0),
        1: CameraPtpStatus(state="Listening", synchronised=False),
    }
    served.station.lose(2)
    expect(cards.nth(0).locator(".camera-state")).to_have_text("connected, sends nothing")
    expect(cards.nth(0).locator(".camera-remarks")).to_contain_text(
        re.compile("sent nothing of a board that other cameras filmed.*it was reset. The next board shows whether")
    )
    expect(cards.nth(0).locator("dl")).to_contain_text("Slave, -0.2 µs from its master, 3.2 ms from the other cameras")
    expect(cards.nth(1).locator("dl")).to_contain_text("no master (Listening)")
    expect(cards.nth(2).locator(".camera-state")).to_have_text("not connected")
    expect(page.locator("#doctor-answer")).to_contain_text("Not examined yet.")
    page.get_by_role("button", name="Examine the station").press("Enter")
    expect(page.locator("#doctor-answer")).to_contain_text("1 of 2 findings need attention.")
    expect(page.locator("#doctor-findings li")).to_have_text(re.compile("Warning: cameras, cam2.*Change the cable."))
    expect(cards.nth(2).locator(".camera-remarks")).to_contain_text("12 packets lost. Change the cable.")


def found_by_the_doctor() -> Report:
    """Return findings that the checks themselves made, with most of the values that texts state."""
    full = os.statvfs_result((4096, 4096, 10**6, 100, 100, 100, 100, 100, 0, 255))
    findings = (
        storage_checks.judge_space(full, "/data"),
        storage_checks.judge_quotas(full, 10**9, KeepConfig(), "/data"),
        machine_checks.judge_lock(2**20, 2**30),
        machine_checks.judge_buffers(2**16, 2**22),
        machine_checks.judge_usb_memory(16, 6),
        machine_checks.judge_wall_clock(machine_checks.TIME_ERROR, 0),
        camera_checks.judge_version((0, 8, 26), "3.42.2", 2),
        machine_checks.judge_cache_of_service(machine_checks.ServiceUnit("no-such-user", Path("/cache"))),
        controller_checks.judge_port(Path("/dev/vaoi-absent"), Machine()),
        warning("storage-full", "Disk is full.", "Free space."),
        fault("newer-code", "Newer.", "Read on."),
    )
    return Report("s", "station.toml", "2026-01-01T00:00:00Z", "host", "1.0", None, findings)


def test_findings_of_the_doctor_are_in_the_language_of_the_page(
    page: Page, served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = found_by_the_doctor()
    monkeypatch.setattr(Examinations, "examine", AsyncMock(return_value=Examination.model_validate(report.document())))
    served.station.recovering[0] = CameraRecoveryStatus(step="spent", why="silent", at="2026-01-01T12:00:00Z")
    page.goto(f"{served.url}/#/cameras")
    page.evaluate("localStorage.setItem('vaoi-language', 'de')")
    page.reload()
    page.get_by_role("button", name="Station untersuchen").click()
    items = page.locator("#doctor-findings li")
    expect(items).to_have_count(len(report.findings))
    first = items.first
    expect(first).to_contain_text("Auf der Datenplatte sind nur 0,00041 GB frei.")
    expect(first.locator(".remedy")).to_contain_text("Dateien löschen")
    expect(page.locator(".camera-card").first).to_contain_text("Alles wurde versucht: Triggerleitung, Kabel und")
    first.locator("summary").click()
    expect(first.locator("[lang=en]")).to_have_text(f"{report.findings[0].message} {report.findings[0].action}")
    expect(items.last.locator("[lang=en]").first).to_have_text("Newer.")
    shown = [item.inner_text() for item in items.all()]
    assert not [text for text in shown if "undefined" in text or "NaN" in text]
    expect(page.locator("#doctor-findings li > p > [lang=en]")).to_have_count(2)  # of the code that is not known
    assert examine(page) == []


def test_settings_are_tried_while_the_line_is_disarmed(page: Page, served: Any) -> None:
    station = served.station
    page.goto(f"{served.url}/#/cameras")
    page.locator("#trial summary").press("Enter")
    page.get_by_label("Camera", exact=True).select_option("cam1")
    page.get_by_label("Exposure, µs").fill("400")
    page.get_by_role("button", name="Start the pulses").press("Enter")
    expect(page.locator("#trial-focus b")).to_have_text("100")
    expect(page.locator("#trial .histogram rect")).to_have_count(64)
    assert page.evaluate(FOCUS_PX) >= 190
    page.get_by_label("Exposure, µs").fill("90")
    expect(page.locator("#trial-answer")).to_have_text("even, 200 µs; exposure 90 µs, gain 0.0 dB")
    assert {camera for camera, _ in station.lighting.tried} == {1}
    for language, scheme in (("en", "light"), ("de", "dark")):
        page.evaluate("language => localStorage.setItem('vaoi-language', language)", language)
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        page.reload()
        begin(page)
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate(WIDE) == [], (language, width)
        assert examine(page) == []
        if PICTURES and language == "en":
            page.set_viewport_size({"width": 1280, "height": 900})
            page.screenshot(path=Path(PICTURES) / "lights" / "trial.png")
    page.evaluate("localStorage.setItem('vaoi-language', 'en')")
    page.reload()
    ended = station.lighting.ended
    begin(page)
    with page.expect_response(lambda response: response.request.method == "DELETE"):
        page.locator("#trial-copy").click()
    expect(page.get_by_role("heading", name="Light programs")).to_be_visible()
    expect(page.get_by_label("Light, row 0")).to_be_visible()
    assert station.lighting.ended == ended + 1, "leaving the page ends the trial"
    page.goto(f"{served.url}/#/cameras")
    begin(page)
    station.arm("demo-board")
    expect(page.locator("#trial-answer")).to_contain_text("Ended: the line was armed.")
    expect(page.locator("#trial-start")).to_be_disabled()


def begin(page: Page) -> None:
    """Open the form and begin the pulses; the first frame is there."""
    page.locator("#trial summary").click()
    page.locator("#trial-start").click()
    expect(page.locator("#trial img")).to_have_count(1)

"""The page full screen at the line: the browser is started as deploy/vaoi-page.desktop states it."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from collections.abc import Iterator
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Playwright, expect, sync_playwright

from tests.api.web.conftest import ARGUMENTS
from tests.needs import chromium

pytestmark = pytest.mark.browser
ENTRY = Path(__file__).parents[3] / "deploy" / "vaoi-page.desktop"
STRICT = "--autoplay-policy=document-user-activation-required"
"""The policy of a browser with windows: nothing is played before the page was touched."""


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as playwright:
        yield playwright


def test_a_login_shows_the_line_with_its_tone_and_again_after_a_crash(
    playwright: Playwright, served: Any, tmp_path: Path
) -> None:
    station, began, bin = served.station, tmp_path / "began", tmp_path / "bin"
    bin.mkdir()
    # The distribution's browser without windows; the entry overrules the policy that it would have with windows.
    real = shlex.join([chromium(), *ARGUMENTS, STRICT, "--remote-debugging-port=0"])
    (bin / "chromium").write_text(f'#!/bin/sh\necho $$ >{began}\nexec {real} "$@"\n')
    (bin / "chromium").chmod(0o755)
    environment = {**os.environ, "HOME": str(tmp_path), "PATH": f"{bin}:{os.environ['PATH']}"}
    started = subprocess.Popen(
        command(served.port), env=environment, start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    try:
        for word in ("Not armed", "Fault"):
            page = playwright.chromium.connect_over_cdp(address(started)).contexts[0].pages[0]
            expect(page.locator("#state-word")).to_have_text(word)
            assert page.evaluate("new AudioContext().state") == "running"
            station.fault("camera-absent", "Camera 2 does not answer.", "Check its cable.")
            expect(page.locator("#state-word")).to_have_text("Fault")
            os.kill(int(began.read_text()), signal.SIGKILL)
        assert (tmp_path / ".config" / "vaoi-page").is_dir()
    finally:
        os.killpg(started.pid, signal.SIGKILL)
        started.communicate(timeout=20)


def command(port: int) -> list[str]:
    """Return what a desktop runs, for the port of the test."""
    entry = ConfigParser(interpolation=None)
    entry.read(ENTRY, encoding="utf-8")
    # The escapes of all strings of such files, then those within quotes.
    line = entry["Desktop Entry"]["Exec"].replace("\\\\", "\\")
    assert "127.0.0.1:8350/" in line
    return [word.replace("\\$", "$") for word in shlex.split(line.replace("8350", str(port)))]


def address(started: subprocess.Popen[str]) -> str:
    """Return the address of the next browser that is started."""
    assert started.stderr is not None
    for line in started.stderr:
        if "DevTools listening on " in line:
            return line.split()[-1]
    raise AssertionError("no browser was started")

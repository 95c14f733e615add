"""A technician exchanges a camera by the page: search, place, and the confirmation of its calibration."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.api.conftest import Served
from tests.api.held.exchange import RealStation, real_station
from tests.api.web.test_views import examine
from tests.drift.conftest import check
from tests.gige.foreign import ForeignCamera

pytestmark = pytest.mark.browser


@pytest.fixture
def station(tmp_path: Path) -> RealStation:
    return real_station(tmp_path)


@pytest.fixture
def served(station: RealStation) -> Iterator[Served]:
    served = Served(station, files=station.files)
    yield served
    served.stop()


def test_a_camera_is_put_in_the_place_of_one_that_is_gone_and_confirmed(
    page: Page, served: Served, station: RealStation
) -> None:
    new = ForeignCamera(f"PAGE-{os.getpid()}")
    page.goto(f"{served.url}/#/cameras")
    page.get_by_text("Exchange a camera: cam1 does not answer").click()
    page.get_by_role("button", name="Search for cameras").click()
    section = page.locator("#exchange")
    expect(section.locator("#exchange-gone")).to_contain_text(
        "Camera cam1 (OLD-1) does not answer. A camera of the same model (Foreign) with serial number "
        f"{new.serial} is there: put it in its place?"
    )
    expect(section.get_by_role("row", name=new.serial)).to_contain_text("with an address of another network")
    assert examine(page) == []
    section.get_by_role("button", name=f"Put {new.serial} in its place").click()
    expect(section.locator("#exchange-answer")).to_contain_text(f"{new.serial} is in the place of camera cam1")
    new.close()
    station.lose()
    expect(section.locator("#exchange-pending")).to_contain_text("let a board pass")
    station.checks = [check(1, [(0.0, 0.0, 0.0), (31.0, -12.0, 2.0), (0.0, 0.0, 0.0)])]
    expect(section.locator("#exchange-pending")).to_contain_text(
        re.compile(r"One board shows.*\(31\.00, [-−]12\.00\) px")
    )
    section.get_by_role("button", name="Confirm the calibration of camera cam1").click()
    expect(section.locator("#exchange-answer")).to_contain_text("is in force, known to ± 0.0")
    expect(section.locator("#exchange-pending")).to_be_empty()
    expect(page.locator("#exchange-title")).to_have_text("Exchange a camera")
    assert station.in_force.uncalibrated == ()

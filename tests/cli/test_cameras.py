"""`vaoi cameras` on loopback: a foreign camera is listed and gets an address; an exchange is that of the station."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.cli.conftest import Result
from tests.gige.foreign import ForeignCamera


@pytest.fixture
def camera() -> Iterator[ForeignCamera]:
    camera = ForeignCamera(f"CLI-{os.getpid()}")
    yield camera
    camera.close()


def test_a_foreign_camera_is_listed_and_gets_a_free_address(camera: ForeignCamera, vaoi: Callable[..., Result]) -> None:
    (line,) = [line for line in vaoi("cameras", "list").out.splitlines() if camera.serial in line]
    assert "10.9.8.7" in line
    assert "not reachable" in line
    assert f"{camera.address} in place of 10.9.8.7" not in line
    done = vaoi("cameras", "set-address", camera.serial)
    assert done.code == 0, done.err
    assert f"{camera.serial}: {camera.address} in place of 10.9.8.7" in done.out
    assert camera.number(0x64C), "and it keeps it"
    assert vaoi("cameras", "set-address", "UNKNOWN").code == 3


def test_an_exchange_names_the_places_of_the_station(
    monkeypatch: pytest.MonkeyPatch, vaoi: Callable[..., Result]
) -> None:
    served = Served(HeldStation())
    monkeypatch.setenv("VAOI_STATION", served.url)
    done = vaoi("cameras", "replace", "cam7", "NEW-1")
    served.stop()
    assert done.code == 2
    assert "no camera 'cam7'" in done.err
    assert "cam0, cam1, cam2" in done.err

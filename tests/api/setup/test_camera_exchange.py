"""A camera in the place of another over REST: search, address, exchange, confirmation, and what is refused."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.held.exchange import RealStation, real_station
from tests.drift.conftest import check
from tests.gige.foreign import ForeignCamera
from vaoi_station.acquisition.cameras.aravis.discovery import discover, find, free_address
from vaoi_station.api.access import scope_needed
from vaoi_station.api.app import create_app
from vaoi_station.errors import StateError
from vaoi_station.files import read_calibration
from vaoi_station.rig.gige.device import MAC_LOW
from vaoi_station.runs.states.schemas import ArmedWith


@pytest.fixture
def station(tmp_path: Path) -> RealStation:
    return real_station(tmp_path)


@pytest.fixture
def client(station: RealStation) -> Iterator[TestClient]:
    app = create_app(station, ["testserver"], files=station.files)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def new() -> Iterator[ForeignCamera]:
    camera = ForeignCamera(f"NEW-{os.getpid()}")
    yield camera
    camera.close()


def post(client: TestClient, path: str, **body: Any) -> tuple[int, dict[str, Any]]:
    reply = client.post(f"/api/v1/cameras/{path}", json=body)
    return reply.status_code, reply.json()


def test_a_camera_of_a_foreign_network_takes_the_place_of_the_one_that_is_gone(
    client: TestClient, station: RealStation, new: ForeignCamera
) -> None:
    found = client.get("/api/v1/cameras/search").json()
    (there,) = [camera for camera in found["found"] if camera["serial"] == new.serial]
    assert (there["address"], there["reachable"], there["in_use"], there.get("place")) == (
        "10.9.8.7",
        False,
        False,
        None,
    )
    (gone,) = found["gone"]
    assert (gone["camera"], gone["serial"], gone["model"]) == (1, "OLD-1", "Foreign")
    assert new.serial in gone["candidates"]
    status, made = post(client, "1/exchange", serial=new.serial)
    assert (status, made["before"]) == (200, "OLD-1")
    assert station.exchanged == [(1, new.serial, new.address)]
    assert new.address.startswith("127."), "it has an address of the network of the port"
    folder, text = station.files.path.parent, station.files.path.read_text()
    assert f'serial = "{new.serial}"' in text
    assert "# along the motion" in text
    assert "OLD-1" in (folder / made["settings_backup"]).read_text()
    assert read_calibration(station.files.config.calibration).uncalibrated == (1,)
    assert client.get("/api/v1/settings").json()["pending"] == [], "nothing waits for a restart"
    status, refused = post(client, "1/exchange/confirm")
    assert (status, refused["code"]) == (422, "too-little-evidence")
    station.checks = [check(1, [(0.0, 0.0, 0.0), (31.0, -12.0, 2.0), (0.0, 0.0, 0.0)])]
    status, confirmed = post(client, "1/exchange/confirm")
    assert (status, confirmed["cameras"]) == (200, [1])
    assert 0 < confirmed["sigma_px"] < 0.1
    assert (folder / confirmed["backup"]).exists()
    now = read_calibration(station.files.config.calibration)
    assert now.uncalibrated == ()
    assert now.camera_matrices[1] == pytest.approx(station.in_force.camera_matrices[1])


def test_what_could_be_a_mistake_is_refused_and_changes_nothing(
    client: TestClient, station: RealStation, new: ForeignCamera
) -> None:
    before = {path: path.read_bytes() for path in station.files.path.parent.iterdir() if path.is_file()}

    def refusal(camera: int = 1, serial: str = new.serial, **body: Any) -> tuple[int, str, str]:
        status, problem = post(client, f"{camera}/exchange", serial=serial, **body)
        return status, problem["code"], problem["detail"]

    assert refusal(serial="UNKNOWN")[:2] == (503, "camera-absent")
    assert refusal(serial="OLD-2")[1:] == (
        "serial-used",
        "The camera OLD-2 is that of place cam2; one camera cannot stand at two places.",
    )
    assert refusal(camera=0)[:2] == (409, "camera-connected")
    assert refusal(camera=7)[0] == 404
    assert refusal(address="192.0.2.77")[:2] == (422, "invalid-input")
    other = ForeignCamera(new.serial, "10.9.8.8")
    other.set_number(MAC_LOW, other.number(MAC_LOW) ^ 1)
    assert refusal()[:2] == (503, "camera-ambiguous")
    other.close()
    station.models[1] = "Other"
    assert refusal()[1] == "camera-model"
    assert "must be a Other" in refusal()[2]
    station.models = ["", "", ""]
    assert "was never seen" in refusal()[2]
    station.models = ["Foreign"] * 3
    station.armed = ArmedWith(board_type="demo-board", board_id=None, job_id=None, runs_left=None)
    assert refusal()[:2] == (409, "line-armed")
    station.armed = None
    station.in_force = station.in_force.model_copy(update={"created": "later"})
    assert refusal()[:2] == (409, "restart-due")
    assert station.exchanged == []
    assert {path: path.read_bytes() for path in before} == before
    assert new.address == "10.9.8.7"


def test_a_camera_at_the_address_of_the_one_that_is_gone_is_told_apart_by_its_serial_number(
    client: TestClient, station: RealStation, new: ForeignCamera
) -> None:
    config = station.files.config
    by_address = config.cameras[1].model_copy(update={"serial": None, "address": new.address})
    cameras = (config.cameras[0], by_address, config.cameras[2])
    station.files.config = config.model_copy(update={"cameras": cameras})
    (gone,) = client.get("/api/v1/cameras/search").json()["gone"]
    assert (gone["serial"], new.serial in gone["candidates"]) == ("OLD-1", True)


def test_files_are_as_before_if_the_last_step_fails(
    client: TestClient, station: RealStation, new: ForeignCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = (station.files.path, station.files.config.calibration)
    before = [path.read_bytes() for path in paths]

    def armed(*_: Any) -> None:
        raise StateError("The line is armed; nothing was changed.", code="line-armed")

    monkeypatch.setattr(station, "exchange_camera", armed)
    assert post(client, "1/exchange", serial=new.serial)[1]["code"] == "line-armed"
    assert [path.read_bytes() for path in paths] == before


def test_all_of_it_needs_the_scope_admin() -> None:
    exchange = "1/exchange"
    for method, path in (
        ("GET", "search"),
        ("POST", "search/address"),
        ("POST", exchange),
        ("POST", f"{exchange}/confirm"),
    ):
        assert scope_needed(method, f"/api/v1/cameras/{path}") == "admin"


def test_the_address_of_a_camera_that_is_absent_now_is_not_given_to_another(
    client: TestClient, station: RealStation, new: ForeignCamera
) -> None:
    """It will come back, and be at an address that two cameras have."""
    first = free_address(find(new.serial, discover()), (), ())
    config = station.files.config
    absent = config.cameras[2].model_copy(update={"serial": None, "address": first})
    station.files.config = config.model_copy(update={"cameras": (*config.cameras[:2], absent)})
    given = post(client, "search/address", serial=new.serial)[1]["address"]
    assert given.startswith("127.")
    assert given != first

"""Opening all cameras of a station: where each is, what they share, and that nothing stays open after a refusal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from vaoi_station.acquisition.cameras.aravis import camera as camera_module
from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.camera import open_aravis_cameras
from vaoi_station.acquisition.cameras.aravis.connection import Identity, PortShare
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.errors import DeviceError, InputError


class OpenConnection:
    """An open connection without a camera; all of a test are in `opened`."""

    opened: list[OpenConnection]
    serials: dict[str, str]
    """Serial numbers by address, where they differ from the address."""
    failing: str | None
    """Address of the camera that refuses its settings."""

    def __init__(self, config: CameraConfig, where: str) -> None:
        self.config, self.where = config, where
        self.identity = Identity(self.serials.get(where, where), where, "eth1")
        self.is_gige, self.packet_bytes = True, 1500
        self.share = PortShare()
        self.closed = False
        self.opened.append(self)

    def configure(self) -> None:
        if self.where == self.failing:
            raise DeviceError("refuses its settings")

    def close(self) -> None:
        self.closed = True


class OpenCamera:
    """A camera that owns its connection."""

    def __init__(self, number: int, connection: OpenConnection) -> None:
        self.number, self.connection = number, connection

    def close(self) -> None:
        self.connection.close()


@pytest.fixture(autouse=True)
def _no_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    OpenConnection.opened, OpenConnection.serials, OpenConnection.failing = [], {}, None
    monkeypatch.setattr(camera_module, "Connection", OpenConnection)
    monkeypatch.setattr(camera_module, "AravisCamera", OpenCamera)
    monkeypatch.setattr(camera_module, "check_silence", lambda _connections: None)
    monkeypatch.setattr(camera_module, "locate", lambda cameras: [c.address or "10.0.0.2" for c in cameras])
    monkeypatch.setattr(network, "link_mbit_s", lambda _port: 1000.0)


def station(tmp_path: Path, *cameras: dict[str, Any], period_s: float = 0.1) -> StationConfig:
    """A station of cameras of 16 × 16 px."""
    return station_config(
        tmp_path, [camera_config(name=f"c{k}", **camera) for k, camera in enumerate(cameras)], period_s
    )


def test_cameras_are_opened_in_their_order_by_address_or_serial_number(tmp_path: Path) -> None:
    by_serial = {"address": None, "serial": "S2"}
    cameras = open_aravis_cameras(station(tmp_path, by_serial, {"address": "10.0.0.7"}))
    assert [camera.number for camera in cameras] == [0, 1]
    assert [connection.where for connection in OpenConnection.opened] == ["10.0.0.2", "10.0.0.7"]


def test_cameras_of_a_port_share_it(tmp_path: Path) -> None:
    config = station(tmp_path, *({"address": f"10.0.0.{k}"} for k in (1, 2, 3)))
    open_aravis_cameras(config)
    assert {connection.share for connection in OpenConnection.opened} == {PortShare(3, 1000.0, 10 * 256)}


def test_one_camera_at_two_addresses_is_refused(tmp_path: Path) -> None:
    OpenConnection.serials = {"10.0.0.1": "SAME", "10.0.0.2": "SAME"}
    with pytest.raises(InputError, match="cameras c0, c1: have the same serial number 'SAME'") as refused:
        open_aravis_cameras(station(tmp_path, {"address": "10.0.0.1"}, {"address": "10.0.0.2"}))
    assert refused.value.code == "camera-ambiguous"
    assert all(connection.closed for connection in OpenConnection.opened)


def test_a_port_that_is_too_slow_for_its_cameras_is_refused(tmp_path: Path) -> None:
    config = station(tmp_path, *({"address": f"10.0.0.{k}", "link_mbit_s": 0.05} for k in (1, 2)))
    with pytest.raises(DeviceError, match="2 cameras on port eth1 need") as refused:
        open_aravis_cameras(config)
    assert refused.value.code == "link-too-slow"
    assert all(connection.closed for connection in OpenConnection.opened)


def test_after_a_refusal_all_cameras_are_closed(tmp_path: Path) -> None:
    OpenConnection.failing = "10.0.0.2"
    with pytest.raises(DeviceError, match="refuses its settings"):
        open_aravis_cameras(station(tmp_path, *({"address": f"10.0.0.{k}"} for k in (1, 2, 3))))
    assert [connection.closed for connection in OpenConnection.opened] == [True] * 3

"""Devices are found by their serial number and opened by their address; every refusal has its reason."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera, StandInError, camera_config
from vaoi_station.acquisition.cameras.aravis import connection, network
from vaoi_station.acquisition.cameras.aravis.network import FoundCamera
from vaoi_station.errors import DeviceError, InputError

pytestmark = pytest.mark.usefixtures("_stand_in")

BY_SERIAL = camera_config(address=None, serial="S2")
FOUND = (FoundCamera("S1", "10.0.0.1"), FoundCamera("S2", "10.0.0.2"), FoundCamera("S3", "USB-1"))


def library(monkeypatch: pytest.MonkeyPatch, **functions: object) -> None:
    monkeypatch.setattr(connection, "aravis", lambda: SimpleNamespace(**functions))


def test_the_device_with_the_serial_number_is_taken() -> None:
    assert connection.find_by_serial(BY_SERIAL, FOUND) == FOUND[1]


def test_an_absent_serial_number_names_those_that_reply() -> None:
    with pytest.raises(DeviceError, match=r"'S2' answers; cameras that answer: S1 at 10\.0\.0\.1\.") as refused:
        connection.find_by_serial(BY_SERIAL, FOUND[:1])
    assert refused.value.code == "camera-absent"
    with pytest.raises(DeviceError, match="cameras that answer: none"):
        connection.find_by_serial(BY_SERIAL, ())


def test_a_serial_number_that_two_devices_have_is_refused() -> None:
    with pytest.raises(InputError, match=r"2 cameras have the serial number 'S2' \(10\.0\.0\.2, USB-2\)") as refused:
        connection.find_by_serial(BY_SERIAL, (*FOUND, FoundCamera("S2", "USB-2")))
    assert refused.value.code == "camera-ambiguous"


def test_gige_cameras_are_searched_by_our_datagrams_and_usb_cameras_by_aravis(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = [("GigEVision", "listed twice", "G"), ("USB3Vision", "S3", "USB-1"), ("USB3Vision", None, "USB-2")]
    library(
        monkeypatch,
        update_device_list=lambda: None,
        get_n_devices=lambda: len(listed),
        get_device_protocol=lambda k: listed[k][0],
        get_device_serial_nbr=lambda k: listed[k][1],
        get_device_id=lambda k: listed[k][2],
    )
    monkeypatch.setattr(network, "discover", lambda: (FoundCamera("S1", "10.0.0.1"),))
    assert connection.search() == (FOUND[0], FOUND[2], FoundCamera("", "USB-2"))


def test_an_opened_camera_is_controlled_by_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = StandInCamera(is_gige=True)
    library(monkeypatch, Camera=SimpleNamespace(new=lambda _address: camera))
    assert connection.open_device(camera_config(), "10.0.0.1") is camera
    camera.device.controlled = False
    with pytest.raises(DeviceError, match=r"another program controls the camera at 10\.0\.0\.1") as refused:
        connection.open_device(camera_config(), "10.0.0.1")
    assert refused.value.code == "camera-in-use"


def test_a_camera_that_cannot_be_opened_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_address: str) -> None:
        raise StandInError("Can't connect.")

    library(monkeypatch, Camera=SimpleNamespace(new=fail))
    with pytest.raises(DeviceError, match=r"there is no camera at 10\.0\.0\.1 \(Can't connect\)") as refused:
        connection.open_device(camera_config(), "10.0.0.1")
    assert refused.value.code == "camera-absent"


def test_an_address_without_a_reply_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    replies = {"10.0.0.1": True, "10.0.0.9": False}
    monkeypatch.setattr(network, "is_reachable", replies.__getitem__)
    connection.require_reply(camera_config(), "10.0.0.1")
    with pytest.raises(DeviceError, match=r"camera c0: there is no camera at 10\.0\.0\.9 \(it does not answer\)"):
        connection.require_reply(camera_config(), "10.0.0.9")

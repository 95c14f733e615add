"""Which camera is opened, which settings it gets, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from tests.acquisition.cameras.aravis.wire.stage import Device, Stage
from vaoi_station.acquisition.cameras.aravis.camera import open_aravis_cameras
from vaoi_station.acquisition.cameras.interface import CameraBack, CameraLost
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError

Plug = Callable[..., Device]
Make = Callable[..., StationConfig]
Open = Callable[[StationConfig], Stage]

OTHER_PROGRAM = """
import sys
from vaoi_station.acquisition.cameras.aravis.library import aravis
camera = aravis().Camera.new(sys.argv[1])
print("mine", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def other_program() -> Iterator[Callable[[Device], subprocess.Popen[str]]]:
    """Another program takes control of a camera, until its standard input ends."""
    programs = []

    def take(device: Device) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", OTHER_PROGRAM, device.address]
        programs.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        assert programs[-1].stdout is not None
        assert programs[-1].stdout.readline() == "mine\n"
        return programs[-1]

    yield take
    for program in programs:
        program.kill()
        program.wait()


def by_serial(config: StationConfig, *serials: str) -> StationConfig:
    content = config.model_dump()
    for camera, serial in zip(content["cameras"], serials, strict=True):
        camera |= {"address": None, "serial": serial}
    return StationConfig.model_validate(content)


def test_cameras_are_found_by_serial_number_whatever_their_order(device: Plug, station: Make, opened: Open) -> None:
    one, two, _ = device(0), device(1), device(2)
    stage = opened(by_serial(station(one, two), two.serial, one.serial))
    stage.load()
    two.fire()
    assert stage.arrival().camera == 0
    one.fire()
    assert stage.arrival().camera == 1


def test_another_camera_at_the_address_of_a_place_is_refused_until_that_of_before_is_back(
    device: Plug, station: Make, opened: Open
) -> None:
    """As after a restart of the station, which remembers the serial number."""
    mine, other = device(0), device(1, serial="OTHER")
    config = station(mine, other)
    known = [camera.model_copy(update={"serial": f"WIRE{k}"}) for k, camera in enumerate(config.cameras)]
    stage = opened(config.model_copy(update={"cameras": tuple(known)}))
    assert (stage.until(CameraLost).camera, stage.cameras[0].health().connected) == (1, True)
    refused = stage.cameras[1].health()
    assert "at 127.0.0.3 is the camera OTHER, but until now it was WIRE1" in refused.message
    assert "put OTHER in its place on the page Cameras" in refused.action
    stage.cameras[1].replace("OTHER", other.address)
    assert stage.until(CameraBack).camera == 1


def test_settings_are_on_the_camera(device: Plug, station: Make, opened: Open) -> None:
    """Read by a second client, by the names of the device's own registers."""
    camera = device(0)
    opened(
        station(
            camera, exposure_us=1234.0, gain_db=3.0, offset_px=(8, 4), packet_bytes=1400, features={"BlackLevel": 7}
        )
    )
    reader = camera.second_client()
    seen = reader.get_device()
    read = {
        name: seen.get_string_feature_value(name)
        for name in ("TriggerMode", "TriggerSource", "TriggerActivation", "PixelFormat")
    }
    assert read == {
        "TriggerMode": "On",
        "TriggerSource": "Line0",
        "TriggerActivation": "RisingEdge",
        "PixelFormat": "Mono8",
    }
    numbers = ("Width", "Height", "OffsetX", "OffsetY")
    assert [seen.get_integer_feature_value(name) for name in numbers] == [96, 64, 8, 4]
    assert [seen.get_float_feature_value(name) for name in ("ExposureTime", "Gain", "BlackLevel")] == [1234.0, 3.0, 7.0]
    assert reader.gv_get_packet_size() == 1400


def test_cameras_of_one_cable_leave_each_other_room(device: Plug, station: Make, opened: Open) -> None:
    cameras = device(0), device(1)
    opened(station(*cameras, link_mbit_s=1000.0, packet_bytes=1500))
    for camera in cameras:
        assert camera.second_client().gv_get_packet_delay() == (1500 + 38) * 8


def test_a_camera_that_another_program_controls_is_lost_until_that_program_ends_and_the_others_film(
    device: Plug, station: Make, opened: Open, other_program: Callable[[Device], subprocess.Popen[str]]
) -> None:
    mine, theirs = device(0), device(1)
    program = other_program(theirs)
    with pytest.raises(DeviceError, match=r"camera c0: another program on 127\.0\.0\.1 controls the camera") as caught:
        open_aravis_cameras(station(theirs))  # not one can be opened
    assert caught.value.code == "camera-in-use"
    stage = opened(station(mine, theirs))
    lost = stage.until(CameraLost)
    assert lost.camera == 1
    assert "another program on 127.0.0.1 controls the camera" in stage.cameras[1].health().message
    stage.load()
    mine.fire()
    assert stage.arrival().camera == 0
    program.communicate()
    assert stage.until_back() == 1
    theirs.fire()
    assert stage.arrival().camera == 1


def test_a_camera_that_runs_freely_is_refused_before_the_first_pulse(device: Plug, station: Make) -> None:
    """It reports that its trigger is on."""
    with pytest.raises(DeviceError, match="camera c1: sends frames although no trigger was fired"):
        open_aravis_cameras(station(device(0), device(1, "free_running")))

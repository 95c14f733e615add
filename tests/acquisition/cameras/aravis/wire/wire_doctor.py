"""`vaoi doctor` checks cameras: its findings, and that it changes nothing on them."""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from tests.acquisition.cameras.aravis.wire.stage import Device, Stage
from tests.doctor.conftest import assert_problem, only
from vaoi_station.config import StationConfig
from vaoi_station.doctor.camera_checks import cameras
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext

Plug = Callable[..., Device]
Make = Callable[..., StationConfig]
MEMORY_BYTES, BLOCK_BYTES, CONTROL_PORT = 0x10000, 512, 3956
STREAM_REGISTERS = range(0xD04, 0xD1C)


def context(config: StationConfig) -> CheckContext:
    return CheckContext(config, Machine(), None)


def memory_of(device: Device) -> bytes:
    """All registers of a camera, read by GVCP without control of it; but for those of the stream.

    A test packet needs them, and every client sets them before it acquires.
    """
    content = bytearray()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(5)
        client.connect((device.address, CONTROL_PORT))
        for place in range(0, MEMORY_BYTES, BLOCK_BYTES):
            number = place // BLOCK_BYTES + 1
            client.send(struct.pack(">BBHHHIHH", 0x42, 0x01, 0x0084, 8, number, place, 0, BLOCK_BYTES))
            reply = client.recv(1024)
            assert struct.unpack(">HHHH", reply[:8])[1::2] == (0x0085, number)
            content += reply[12:]
    return bytes(content[: STREAM_REGISTERS.start] + content[STREAM_REGISTERS.stop :])


def test_cameras_that_are_fit_stay_as_they_are(device: Plug, station: Make) -> None:
    plugged = [device(0), device(1)]
    before = [memory_of(camera) for camera in plugged]
    left, right, port = cameras(context(station(*plugged)))
    assert [memory_of(camera) for camera in plugged] == before
    assert {finding.level for finding in (left, right, port)} == {Level.OK}
    assert (left.subject, left.figures["serial"], left.figures["trigger_mode"]) == ("c0", "WIRE0", "Off")
    assert (port.subject, port.figures["cameras"], port.figures["packet_bytes"]) == ("lo", 2, 9000)


def test_a_camera_that_does_not_state_the_size_of_its_sensor_is_fit(device: Plug, station: Make) -> None:
    camera, _port = cameras(context(station(device(0, "sizeless"))))
    assert (camera.level, camera.subject) == (Level.OK, "c0"), camera.message


def test_the_station_opens_them_afterwards(device: Plug, station: Make, opened: Callable[..., Stage]) -> None:
    config = station(device(0))
    assert {finding.level for finding in cameras(context(config))} == {Level.OK}
    opened(config)


def test_a_camera_that_is_not_there_hides_no_other(device: Plug, station: Make) -> None:
    here, gone = device(0), device(1)
    config = station(gone, here)
    gone.unplug()
    absent, there, _ = cameras(context(config))
    assert_problem(absent, Level.FAULT, f"there is no camera at {gone.address}")
    assert absent.action.endswith(f"Try: ping -c 1 {gone.address}")
    assert there.level is Level.OK


def test_a_camera_that_another_program_uses(device: Plug, station: Make, tmp_path: Path) -> None:
    camera = device(0)
    use = "import sys; from vaoi_station.acquisition.cameras.aravis.library import aravis; "
    use += "held = aravis().Camera.new(sys.argv[1]); print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", use, camera.address], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "held\n"
        finding = only(cameras(context(station(camera))))
        program.communicate("")
    assert_problem(finding, Level.FAULT, "another program on 127.0.0.1 controls the camera")

"""One connection: search, clock, settings, stream, warnings, and failures of the camera."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import SimpleQueue

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera, StandInError, camera_config
from vaoi_station.acquisition.cameras.aravis import connection as connection_module
from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.connection import (
    Connection,
    PortShare,
    find_clock,
)
from vaoi_station.acquisition.cameras.aravis.discovery import FoundCamera
from vaoi_station.acquisition.cameras.aravis.stream import SlotResult
from vaoi_station.errors import DeviceError, InputError


@pytest.mark.parametrize(("hertz", "wanted_ns"), [(125_000_000, 8_000), (1_000_000_000, 1_000), (0, 1_000)])
def test_ticks_of_gige_vision_1_are_converted(hertz: int, wanted_ns: int) -> None:
    camera = StandInCamera()
    del camera.device.features["TimestampLatch"]
    camera.device.features |= {"GevTimestampControlLatch": 0, "GevTimestampValue": 1_000}
    camera.device.tick_hz = hertz
    assert find_clock(camera, "camera c0")() == wanted_ns


def test_the_registers_of_the_standard_are_the_clock_of_a_camera_that_does_not_describe_one() -> None:
    """Prosilica_GC1280M, PGR_Flea3, PCO1600 and TIS_dmk_33GX174 of areaDetector/aravisGigE."""
    camera = StandInCamera(is_gige=True)
    del camera.device.features["TimestampLatch"]
    camera.device.tick_hz = 500_000_000
    camera.device.registers = {0x948: 1, 0x94C: 5}
    assert find_clock(camera, "camera c0")() == 2 * ((1 << 32) + 5)
    assert camera.device.registers[0x944] == 2, "it is latched before it is read"


def test_a_camera_without_a_latch_is_refused() -> None:
    camera = StandInCamera()
    del camera.device.features["TimestampLatchValue"]
    with pytest.raises(DeviceError, match="camera c0: has no time stamp that can be latched") as refused:
        find_clock(camera, "camera c0")
    assert refused.value.code == "clock-unknown"


pytestmark = pytest.mark.usefixtures("_stand_in")

FOUND = (FoundCamera("S1", "10.0.0.1"), FoundCamera("S2", "10.0.0.2"), FoundCamera("S3", "USB-1"))


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (FOUND[:1], r"'S2' answers; cameras that answer: S1 at 10\.0\.0\.1\."),
        ((), "cameras that answer: none"),
        ((*FOUND, FoundCamera("S2", "USB-2")), r"2 cameras have the serial number 'S2' \(10\.0\.0\.2, USB-2\)"),
    ],
)
def test_a_serial_number_must_be_that_of_one_camera(
    monkeypatch: pytest.MonkeyPatch, found: tuple[FoundCamera, ...], words: str
) -> None:
    replies = {"10.0.0.1": True, "10.0.0.9": False}
    monkeypatch.setattr(network, "is_reachable", replies.__getitem__)
    monkeypatch.setattr(connection_module, "search", lambda: FOUND)
    by_serial, by_address, absent = (
        camera_config(address=address, serial=serial)
        for address, serial in ((None, "S2"), ("10.0.0.1", None), ("10.0.0.9", None))
    )
    assert connection_module.locate_each([by_serial, by_address]) == ["10.0.0.2", "10.0.0.1"]
    monkeypatch.setattr(connection_module, "search", lambda: found)
    with pytest.raises((DeviceError, InputError), match=words):
        connection_module.locate(by_serial)
    with pytest.raises(DeviceError, match=r"camera c0: there is no camera at 10\.0\.0\.9 \(it does not answer\)"):
        connection_module.locate(absent)


RESULTS: SimpleQueue[SlotResult] = SimpleQueue()


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> StandInCamera:
    """The camera that the next connection opens."""
    camera = StandInCamera()
    monkeypatch.setattr(connection_module, "open_device", lambda _config, _where: camera)
    return camera


@pytest.fixture
def connection(camera: StandInCamera) -> Iterator[Connection]:
    connection = Connection(camera_config(), "USB-1")
    yield connection
    connection.close()


def test_a_camera_that_is_gone_is_released_without_access_to_it(camera: StandInCamera, connection: Connection) -> None:
    connection.start(RESULTS.put)
    connection.close(gone=True)
    for thread in threading.enumerate():
        if thread.name == "camera-c0-remains":
            thread.join(10)
    assert camera.running, "nothing was sent to it"
    with pytest.raises(DeviceError, match="camera c0: is closed"):
        connection.read_clock(0)


def test_a_camera_that_refuses_to_stop_is_configured_nevertheless(camera: StandInCamera) -> None:
    def refuse() -> None:
        raise StandInError("not running")

    camera.stop_acquisition = refuse  # type: ignore[method-assign]
    connection = Connection(camera_config(), "USB-1")
    connection.configure()
    connection.close()
    assert camera.device.features["ExposureTime"] == 250.0


def test_frames_of_another_size_than_the_slots_are_refused(camera: StandInCamera, connection: Connection) -> None:
    camera.payload = 48
    with pytest.raises(DeviceError, match=r"sends frames of 48 bytes, but 16×16 px Mono8 are 256") as refused:
        connection.configure()
    assert refused.value.code == "frame-size"


@pytest.fixture
def gige(camera: StandInCamera, monkeypatch: pytest.MonkeyPatch) -> Iterator[Connection]:
    """A GigE camera on a port with an MTU of 1500; its address is not looked up on this computer."""
    connection = Connection(camera_config(), "10.0.0.1")
    connection.is_gige = True
    monkeypatch.setattr(network, "mtu_to", lambda _address: 1500)
    monkeypatch.setattr(network, "widen_receive_buffer", lambda _port, wanted: min(wanted, 1_000_000))
    yield connection
    connection.close()


def test_a_receive_buffer_that_is_too_small_is_warned_of(camera: StandInCamera, gige: Connection) -> None:
    gige.share = PortShare(socket_bytes=4_000_000)
    gige.start(RESULTS.put)
    assert gige.granted_bytes == 1_000_000
    assert camera.stream.properties["frame-retention"] == connection_module.RETENTION_US
    assert gige.warning().startswith("The kernel holds 1.0 MB of its packets, 4.0 MB are wanted")
    gige.share = PortShare(socket_bytes=500_000)
    assert gige.warning() == ""


def test_a_link_that_is_slower_after_a_loss_is_warned_of(gige: Connection) -> None:
    """As Gigabit Ethernet with a broken pair of wires, or a switch that was exchanged."""
    gige.packet_bytes, gige._speed_mbit_s = 1500, 100.0
    gige.share = PortShare(row_s=5e-6, packet_bytes=1500)
    assert gige.warning().startswith("Its link has 100 Mbit/s now, so that a frame takes 0 ms; a row took 0 ms")
    gige.share = PortShare(row_s=1.0, packet_bytes=9000)
    assert gige.warning().startswith(
        "Only packets of 1500 bytes come from it now, of 9000 when the station was started"
    )
    gige.share = PortShare(row_s=1.0, packet_bytes=1500)
    assert gige.warning() == ""


def test_packets_that_were_sent_again_are_warned_of(camera: StandInCamera, gige: Connection) -> None:
    gige.start(RESULTS.put)
    camera.stream.counters |= {"n_received_packets": 1_000, "n_resent_packets": 12}
    assert gige.warning() == "", "twelve may be of one disturbance"
    camera.stream.counters |= {"n_received_packets": 10_000, "n_resent_packets": 120}
    assert gige.warning().startswith("1.2% of its packets were lost on the way and sent again")

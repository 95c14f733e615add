"""Pitfalls of real cameras: the rig's camera, scripted, sends each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Stage, noise
from tests.gige.camera import Camera
from vaoi_station.acquisition.cameras.interface import CameraLost
from vaoi_station.acquisition.pairing.evidence import id_step
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.rig.gige.camera import as_it_is
from vaoi_station.rig.gige.packets import TRAILER

Open = Callable[[StationConfig], Stage]
Plug = Callable[..., Camera]
Begin = Callable[..., Stage]
PIXELS = noise(1).tobytes()
VENDOR_ADDRESS, MODEL_ADDRESS = 0x48, 0x68


def without_fifth(packets: list[bytes]) -> list[bytes]:
    return packets[:5] + packets[6:]


@pytest.fixture
def plug() -> Iterator[Callable[..., Camera]]:
    """Plug in a scripted camera: `plug(extended, chunks)`."""
    cameras: list[Camera] = []

    def begin(extended: bool = False, chunks: bool = False) -> Camera:
        cameras.append(Camera(f"127.0.0.{2 + len(cameras)}", extended=extended, chunks=chunks))
        return cameras[-1]

    yield begin
    for camera in cameras:
        camera.close()


@pytest.fixture
def stage(tmp_path: Path, opened: Open) -> Callable[..., Stage]:
    """Open the station of one camera and queue slots: `stage(camera, **changes of its configuration)`."""

    def begin(camera: Camera, **changes: object) -> Stage:
        content = {"name": "c0", "address": camera.address, "width": WIDTH, "height": HEIGHT, "packet_bytes": 600}
        staged = opened(station_config(tmp_path, [camera_config(**content | changes)]))
        staged.load()
        return staged

    return begin


def test_what_aravis_calls_a_success_can_be_torn(plug: Plug, stage: Begin) -> None:
    """Each of these frames was reported as complete, with pixels of an older frame in it."""
    camera = plug()
    staged = stage(camera)

    def number_beyond_the_frame(packets: list[bytes]) -> list[bytes]:
        """Aravis drops all further packets, and marks them as received."""
        return [packets[0], camera.stream.payload(camera.next_id - 1, 99, bytes(500)), *packets[1:]]

    def early_trailer(packets: list[bytes]) -> list[bytes]:
        """The leader promises all lines."""
        return [*packets[:6], camera.stream.header(TRAILER, camera.next_id - 1, 6) + packets[-1][8:]]

    def fifth_again_as_eighth(packets: list[bytes]) -> list[bytes]:
        """Aravis #311: the true eighth packet is dropped as a duplicate."""
        return [*packets[:7], packets[8][:8] + packets[5][8:], *packets[7:]]

    faults = []
    for script in (number_beyond_the_frame, early_trailer, fifth_again_as_eighth, as_it_is):
        camera.expose(PIXELS, script)
        arrival = staged.arrival()
        assert arrival.complete == (arrival.frame_id is not None) == (script is as_it_is), arrival.fault
        faults.append(arrival.fault)
    beyond, early, twice, good = faults
    assert beyond.startswith("0 of its 6144 bytes arrived although it ended: packets had wrong numbers")
    assert early.startswith("2820 of its 6144 bytes arrived although it ended")
    assert "a packet came twice, and one of them may have been another packet under a wrong number" in twice
    assert good == "", "only the frame with the fault is suspect"


def test_lost_packets_are_sent_again_and_a_storm_of_them_does_no_harm(plug: Plug, stage: Begin) -> None:
    camera = plug()
    staged = stage(camera)
    camera.resend_script = lambda packets: [packet for packet in packets for _ in range(20)]
    camera.expose(PIXELS, without_fifth)
    mended = staged.arrival()
    assert mended.complete, mended.fault
    assert staged.ring.memory(mended.slot).tobytes() == PIXELS
    assert camera.resend_requests >= 1, "a busy computer asks again"
    assert staged.counted("n_resent_packets") == 1
    camera.expose(PIXELS)
    assert staged.arrival().complete, "packets of a frame that has ended are ignored"
    camera.resend_script = lambda _packets: ()
    camera.expose(PIXELS, without_fifth)
    assert staged.arrival().fault == "parts of the frame did not arrive in time"


def test_resent_packets_that_come_twice_spoil_no_frame_but_of_cameras_that_misnumber_them(
    plug: Plug, stage: Begin
) -> None:
    """The fifth is late and was asked for, so it comes twice; the seventh, which is last, ends the frame."""
    camera = plug()

    def without_two(packets: list[bytes]) -> list[bytes]:
        return [*packets[:5], packets[6], *packets[8:]]

    camera.resend_script = lambda packets: [packet for packet in packets for _ in range(2)]
    for model, vendor, whole in (("Scripted", "Test", True), ("Blackfly BFLY-PGE-14S2C", "Point Grey Research", False)):
        for at, text in ((VENDOR_ADDRESS, vendor), (MODEL_ADDRESS, model)):
            camera.write(at, text.encode().ljust(32, b"\0"))
        staged = stage(camera)
        camera.expose(PIXELS, without_two)
        arrival = staged.arrival()
        assert staged.counted("n_duplicated_packets") >= 1
        assert arrival.complete is whole, arrival.fault
        if whole:
            assert staged.ring.memory(arrival.slot).tobytes() == PIXELS
        staged.close()


@pytest.mark.parametrize(
    ("extended", "ids"),
    [
        (False, [65534, 65535, 1, 2]),
        (True, [65534, 65535, 65536, 65537]),
        (True, [2**63 - 1, 2**63]),
        (True, [2**64 - 2, 2**64 - 1, 1, 2]),
    ],
)
def test_frame_ids_of_16_and_64_bits_wrap(plug: Plug, stage: Begin, extended: bool, ids: list[int]) -> None:
    camera = plug(extended=extended)
    staged = stage(camera)
    camera.next_id = ids[0]
    for k, number in enumerate(ids):
        camera.expose(noise(k).tobytes())
        arrival = staged.arrival()
        assert (arrival.complete, arrival.frame_id) == (True, number)
        assert (staged.ring.memory(arrival.slot) == noise(k)).all()
    assert [id_step(*pair) for pair in pairwise(ids)] == [1] * (len(ids) - 1)


def test_a_packet_with_the_id_of_a_later_frame_costs_frames_until_the_next_loading(plug: Plug, stage: Begin) -> None:
    """Aravis takes all frames with lower ids for late ones, and drops up to 99 of them."""
    camera = plug()
    staged = stage(camera)
    camera.expose(PIXELS)
    assert staged.arrival().complete
    camera.send([camera.stream.payload(60, 3, bytes(564))])
    camera.expose(PIXELS)
    stray = staged.arrival()
    assert (stray.complete, stray.fault) == (False, "parts of the frame did not arrive in time")
    assert staged.counted("n_ignored_packets") > 0
    staged.cameras[0].take_back()
    staged.load(bay=1)
    camera.expose(PIXELS)
    assert staged.arrival().complete


def test_chunk_mode_is_switched_off_or_named(plug: Plug, stage: Begin) -> None:
    camera = plug(chunks=True)
    staged = stage(camera)
    camera.expose(PIXELS)
    assert staged.arrival().complete
    camera.put("ChunkModeActive", 1)
    camera.expose(PIXELS)
    assert "its ChunkModeActive was switched on" in staged.arrival().fault


def test_a_camera_that_keeps_chunk_mode_is_refused(plug: Plug, stage: Begin) -> None:
    camera = plug(chunks=True)
    camera.faults.keeps["ChunkModeActive"] = 1
    with pytest.raises(DeviceError, match="ChunkModeActive was set to False, but reads True"):
        stage(camera)


def test_a_camera_that_restarts_within_its_heartbeat_is_opened_again(plug: Plug, stage: Begin) -> None:
    """It answers all the while, with default settings, and its clock and its frame ids begin anew."""
    camera = plug()
    staged = stage(camera)
    camera.expose(PIXELS)
    assert staged.arrival().complete
    camera.boot()
    assert camera.expose(PIXELS) == 0, "it is not in trigger mode any more"
    assert "it has restarted" in staged.until(CameraLost).why
    staged.until_back()
    camera.expose(PIXELS)
    arrival = staged.arrival()
    assert (arrival.complete, arrival.frame_id) == (True, 1)
    assert camera.value("ExposureTime") == 250

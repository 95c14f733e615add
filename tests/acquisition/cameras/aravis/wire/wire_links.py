"""Packets as large as the way from the camera passes, found by test packets with *don't fragment*."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Stage, noise
from tests.gige.camera import Camera
from vaoi_station.config import StationConfig
from vaoi_station.rig.gige.device import PACKET_SIZE, STREAM_ADDRESS, STREAM_PORT

Open = Callable[[StationConfig], Stage]
FIRE, DO_NOT_FRAGMENT = 1 << 31, 1 << 30


class TestedCamera(Camera):
    """A camera behind a switch that drops packets above a size."""

    __test__ = False

    def __init__(self, address: str, path_bytes: int = 9000, *, fires: bool = True, once: bool = False) -> None:
        self.once, self.tried, self._before = once, list[int](), 0
        super().__init__(address)
        self.faults.path_bytes, self.faults.test_packets = path_bytes, fires

    def _on_bootstrap(self, address: int, client: tuple[str, int]) -> None:
        now, before = self.number(PACKET_SIZE), self._before
        if address == PACKET_SIZE:
            self._before = now
            if now & FIRE:
                assert now & DO_NOT_FRAGMENT
                assert self.number(STREAM_PORT)
                assert self.number(STREAM_ADDRESS)
                if self.once and before & FIRE:
                    return  # only a change of the bit fires
                self.tried.append(now & 0xFFFF)
        super()._on_bootstrap(address, client)
        if self.once and address == PACKET_SIZE:
            self.set_number(PACKET_SIZE, now)  # the bit stays


@pytest.fixture
def plug() -> Iterator[Callable[..., TestedCamera]]:
    cameras: list[TestedCamera] = []

    def begin(path_bytes: int = 9000, **ways: bool) -> TestedCamera:
        cameras.append(TestedCamera(f"127.0.0.{2 + len(cameras)}", path_bytes, **ways))
        return cameras[-1]

    yield begin
    for camera in cameras:
        camera.close()


@pytest.fixture
def stage(tmp_path: Path, opened: Open) -> Callable[..., Stage]:
    def begin(camera: Camera, **changes: Any) -> Stage:
        content = {"name": "c0", "address": camera.address, "width": WIDTH, "height": HEIGHT} | changes
        staged = opened(station_config(tmp_path, [camera_config(**content)]))
        staged.load()
        return staged

    return begin


@pytest.mark.parametrize(
    ("path_bytes", "ways", "wanted", "low", "high"),
    [
        (9000, {}, None, 9000, 9000),
        (9000, {"once": True}, None, 9000, 9000),
        (4000, {}, None, 3936, 4000),
        (1500, {"once": True}, None, 1436, 1500),
        (9000, {}, 1400, 1400, 1400),
        (9000, {"fires": False}, None, 9000, 9000),
    ],
)
def test_packets_are_as_large_as_the_way_from_the_camera_passes(
    plug: Callable[..., TestedCamera],
    stage: Callable[..., Stage],
    path_bytes: int,
    ways: dict[str, bool],
    wanted: int | None,
    low: int,
    high: int,
) -> None:
    camera = plug(path_bytes, **ways)
    staged = stage(camera, packet_bytes=wanted)
    used = camera.stream.packet_bytes
    assert low <= used <= high
    assert camera.tried[0] == min(wanted or 9000, 9000), "the largest one is tried first"
    assert len(camera.tried) == 1 or used < 9000 or not camera.faults.test_packets
    pixels = noise(3)
    camera.expose(pixels.tobytes())
    arrival = staged.arrival()
    assert arrival.complete, arrival.fault
    assert (staged.ring.memory(arrival.slot) == pixels).all()

"""Cameras on addresses of a network namespace, and stations of them."""

from __future__ import annotations

import gc
import gzip
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Device, Stage, thread_names, wait_for_remains
from tests.needs import DESCRIPTIONS, need_descriptions, need_referee
from vaoi_station.config import StationConfig
from vaoi_station.rig.gige.camera import Camera
from vaoi_station.rig.gige.first_values import Sensor
from vaoi_station.rig.network import LoopbackAddresses, addresses


@pytest.fixture(scope="session", autouse=True)
def _addresses() -> Iterator[None]:
    with LoopbackAddresses(addresses(14)):
        yield


@pytest.fixture
def device(tmp_path: Path) -> Iterator[Callable[..., Device]]:
    """Plug in a camera: `device(number, *changes, serial=…)`."""
    devices: list[Device] = []

    def plug(number: int, *changes: str, serial: str | None = None) -> Device:
        devices.append(Device(number, serial or f"WIRE{number}", changes, tmp_path / f"film{number}-{len(devices)}"))
        return devices[-1]

    yield plug
    for plugged in devices:
        plugged.unplug()


@pytest.fixture
def plug() -> Iterator[Callable[[str], Camera]]:
    """Plug in a camera with the description of this name."""
    need_descriptions()
    need_referee()
    plugged: list[Camera] = []

    def one(name: str) -> Camera:
        text = gzip.decompress((DESCRIPTIONS / f"{name}.xml.gz").read_bytes()).decode("utf-8-sig")
        number = len(plugged) + 2
        plugged.append(Camera(f"127.0.0.{number}", text, serial=f"REAL{number}", sensor=Sensor(640, 480)))
        return plugged[-1]

    yield one
    for camera in plugged:
        camera.close()


@pytest.fixture
def station(tmp_path: Path) -> Callable[..., StationConfig]:
    """A station of these devices, by address; keyword arguments change all cameras."""

    def make(*devices: Device, **changes: object) -> StationConfig:
        cameras = [
            camera_config(**{"name": f"c{k}", "address": d.address, "width": WIDTH, "height": HEIGHT} | changes)
            for k, d in enumerate(devices)
        ]
        return station_config(tmp_path, cameras)

    return make


@pytest.fixture
def opened() -> Iterator[Callable[[StationConfig], Stage]]:
    """Open a station's cameras; they are closed at the end, and every thread of ours and of Aravis is gone."""
    stages: list[Stage] = []

    def begin(config: StationConfig) -> Stage:
        stages.append(Stage(config))
        return stages[-1]

    yield begin
    for stage in stages:
        stage.close()
    stages.clear()
    gc.collect()
    wait_for_remains()
    # A scripted camera (tests/gige) serves from a thread of this process until its own fixture ends.
    assert [t for t in threading.enumerate() if not t.name.startswith("camera 127.")] == [threading.main_thread()]
    assert "arv_gv_stream" not in thread_names()

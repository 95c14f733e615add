"""Cameras on addresses of a network namespace, and stations of them."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Device, Stage, thread_names, wait_for_remains
from vaoi_station.config import StationConfig
from vaoi_station.rig.devices.network import LoopbackAddresses, addresses


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
def station(tmp_path: Path) -> Callable[..., StationConfig]:
    """A station of these devices, by address; keyword arguments change all cameras."""

    def make(*devices: Device, **changes: object) -> StationConfig:
        camera = {"backend": "aravis", "width": WIDTH, "height": HEIGHT, "exposure_us": 250.0}
        return StationConfig.model_validate(
            {
                "calibration": "calibration.json",
                "board_types": "types",
                "data": "data",
                "line": {
                    "conveyor_mm_s": (0.0, 100.0),
                    "barrier_mm": -40.0,
                    "start_delay_s": 0.1,
                    "trigger_period_s": 0.1,
                    "tail_s": 0.2,
                    "longest_board_mm": 40.0,
                },
                "cameras": [
                    {"name": f"c{k}", "address": d.address, **camera, **changes} for k, d in enumerate(devices)
                ],
                "controller": {"backend": "serial"},
                "ring": {"directory": tmp_path},
            }
        )

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
    assert threading.enumerate() == [threading.main_thread()]
    assert "arv_gv_stream" not in thread_names()

"""A camera that answers and sends nothing, and one that does not answer although its link is up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Stage, noise
from tests.gige.camera import Camera
from vaoi_station.acquisition.cameras.aravis import camera as camera_module
from vaoi_station.acquisition.cameras.aravis.recovery import Recovery
from vaoi_station.acquisition.cameras.interface import CameraBack, CameraLost, DeviceFault
from vaoi_station.config import StationConfig

PIXELS = noise(5).tobytes()


class HangingCamera(Camera):
    """It hangs until a new start of its acquisition cures it, or only its power."""

    def __init__(self, address: str, cure: str) -> None:
        self._starts, self._cure = 0, cure
        super().__init__(address)

    def cure(self, what: str) -> None:
        """End the hanging with the second start: the first one is that of the camera which is opened again."""
        if what == "AcquisitionStart" and self._cure == "restart" and self.faults.sends_nothing:
            self._starts += 1
            self.faults.sends_nothing = self._starts < 2


@pytest.fixture
def cameras() -> Iterator[list[HangingCamera]]:
    """Cameras that are closed after the station, which else would wait for them."""
    cameras: list[HangingCamera] = []
    yield cameras
    for camera in cameras:
        camera.close()


@pytest.fixture
def hang(
    tmp_path: Path, cameras: list[HangingCamera], opened: Callable[[StationConfig], Stage]
) -> Iterator[Callable[[str], Any]]:
    """Open the station of one camera that will hang, with a command that switches its power."""
    ended = threading.Event()
    switched = tmp_path / "switched"

    def switch(camera: HangingCamera) -> None:
        """Do what the PoE switch does, once the command has asked for it."""
        while not ended.wait(0.01):
            if switched.exists():
                switched.unlink()
                camera.plug()

    def begin(cure: str) -> tuple[HangingCamera, Stage]:
        camera = HangingCamera("127.0.0.2", cure)
        cameras.append(camera)
        program = tmp_path / "power"
        program.write_text(f'#!/bin/sh\necho "$@" > {switched}\nwhile [ -e {switched} ]; do sleep 0.01; done\n')
        program.chmod(0o755)
        config = camera_config(name="c0", address=camera.address, width=WIDTH, height=HEIGHT)
        station = station_config(tmp_path, [config]).model_dump()
        station["camera_power"] = {"command": (str(program), "{address}")}
        stage = opened(StationConfig.model_validate(station))
        stage.load()
        threading.Thread(target=switch, args=(camera,), name="camera 127.0.0.2 power").start()
        camera.expose(PIXELS)
        assert stage.arrival().complete
        camera.faults.sends_nothing = True
        return camera, stage

    yield begin
    ended.set()


class Now:
    """The time of the steps: every board comes minutes after the one before."""

    def __init__(self) -> None:
        self.later_s = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.later_s


@pytest.mark.parametrize(
    ("cure", "taken"),
    [
        ("restart", ["reopen", "restart"]),
        ("power", ["reopen", "restart", "reset", "power"]),
    ],
)
def test_a_camera_that_sends_nothing_is_brought_back_by_one_step_after_the_other(
    hang: Callable[[str], Any], cure: str, taken: list[str]
) -> None:
    camera, stage = hang(cure)
    device, now = stage.cameras[0], Now()
    device._recovery = Recovery(now)
    for step in taken:
        board_s = time.monotonic()
        assert camera.expose(PIXELS), "the camera is armed and sends, but nothing arrives"
        device.sent_nothing(7, board_s)
        if step == "restart":
            assert "sent nothing of 7 rows; its stream was started again" in stage.until(DeviceFault).error.message
        else:
            assert "sent nothing of 7 rows" in stage.until(CameraLost).error.message
            stage.until(CameraBack)
        stage.wait(lambda: device.health().connected and camera.armed)
        state = device.health().recovery
        assert (state and state.step, state and state.why) == (step, "silent")
        assert "The next board shows whether that helped" in device.health().message
        now.later_s += 200.0
    camera.expose(PIXELS)
    arrival = stage.arrival()
    assert arrival.complete, arrival.fault
    assert (device.health().recovery, device.health().message) == (None, "")


def test_a_deaf_camera_on_a_link_that_is_up_gets_its_power_switched(
    hang: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_module, "ABSENT_LIMIT_S", 0.5)
    camera, stage = hang("power")
    camera.faults.silent = True
    assert "it does not answer any more" in stage.until(CameraLost).error.message
    stage.until(CameraBack)
    stage.wait(lambda: stage.cameras[0].health().connected and camera.armed)
    state = stage.cameras[0].health().recovery
    assert (state and state.step, state and state.why) == ("power", "absent")
    camera.expose(PIXELS)
    assert stage.arrival().complete

"""A camera dies and comes back: it is opened again from scratch, and no other camera is affected."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.wire.stage import Device, Stage, noise, thread_names, wait_for_remains
from vaoi_station.acquisition.cameras.aravis import camera as camera_module
from vaoi_station.acquisition.cameras.aravis.camera import AravisCamera
from vaoi_station.acquisition.cameras.aravis.connection import Connection
from vaoi_station.acquisition.cameras.interface import Arrival, CameraBack, CameraExposure, CameraLost
from vaoi_station.backoff import BackoffPolicy
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError

Plug = Callable[..., Device]
Make = Callable[..., StationConfig]
Open = Callable[[StationConfig], Stage]


def test_a_camera_that_is_killed_comes_back_and_the_others_lose_nothing(
    device: Plug, station: Make, opened: Open
) -> None:
    """Pulses go on at both cameras all the while; what is filmed by whom is counted to the last frame."""
    steady, mortal = device(0), device(1)
    steady.show(noise(1))
    mortal.show(noise(2))
    stage = opened(station(steady, mortal, exposure_us=777.0))
    stage.load()
    stage.cameras[1].set_exposure(CameraExposure((900.0,), 6.0))
    before_s = time.monotonic()
    mortal.unplug()
    sent: list[int] = []
    received: list[int | None] = []
    news: list[CameraLost | CameraBack] = []

    def pulse() -> None:
        """One frame of the steady camera, there and back; the other one's news on the way."""
        sent.append(steady.fire(0))
        while True:
            item = stage.news.get(timeout=20)
            if isinstance(item, Arrival):
                assert item.camera == 0
                assert item.complete, item.fault
                received.append(item.frame_id)
                stage.cameras[0].queue(stage.slot(item.slot))
                return
            assert isinstance(item, CameraLost | CameraBack)
            news.append(item)

    while not news:
        pulse()
    lost_s = time.monotonic()
    [lost] = news
    assert isinstance(lost, CameraLost)
    assert lost.camera == 1
    assert before_s - 1 < lost.since_s < lost_s
    assert lost_s - before_s < 10, "noticed long before Aravis would"
    assert lost.error.message == "camera c1: there is no camera at 127.0.0.3 (it does not answer any more)."
    health = stage.cameras[1].health()
    assert not health.connected
    assert "there is no camera at 127.0.0.3" in health.message
    with pytest.raises(DeviceError, match="camera c1: there is no camera"):
        stage.cameras[1].read_clock()
    for _ in range(20):
        pulse()

    stage.cameras[1].set_exposure(CameraExposure((777.0,), 0.0))
    mortal.plug()
    back_s = time.monotonic()
    while len(news) == 1:
        pulse()
    assert isinstance(news[1], CameraBack)
    assert time.monotonic() - back_s < 30
    assert received == sent
    mortal.fire(0)
    arrival = stage.arrival()
    assert (arrival.camera, arrival.complete) == (1, True), "it got its slots again"
    assert (stage.ring.memory(arrival.slot) == noise(2)).all()
    assert mortal.second_client().get_exposure_time() == 777.0
    assert dict(stage.cameras[1].health().counters)["n_losses"] == 1


def test_slots_of_a_lost_camera_can_be_taken_back_and_given_again(device: Plug, station: Make, opened: Open) -> None:
    mortal = device(0)
    stage = opened(station(mortal))
    stage.load()
    mortal.unplug()
    stage.until(CameraLost)
    count = stage.ring.layout.slots_per_camera
    assert sorted(stage.cameras[0].take_back()) == list(range(count))
    stage.load(bay=1)
    mortal.plug()
    stage.until_back()
    mortal.fire()
    assert stage.ring.layout.place(stage.arrival().slot)[0] == 1


def test_a_camera_that_is_no_longer_ours_is_opened_again(device: Plug, station: Make, opened: Open) -> None:
    """As after a stop of this process that was longer than the camera's heartbeat."""
    camera = device(0)
    stage = opened(station(camera))
    stage.load()
    camera.release()
    assert "no longer controlled by this station" in stage.until(CameraLost).error.message
    stage.until_back()
    camera.fire()
    assert stage.arrival().complete


def test_a_camera_that_refuses_its_settings_is_not_tried_again_until_it_is_unplugged(
    device: Plug, station: Make, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_module, "PACE", BackoffPolicy(first_s=5.0, longest_s=60.0, proven_s=10.0))
    mortal = device(0)
    stage = opened(station(mortal))
    camera = stage.cameras[0]
    mortal.unplug()
    stage.until(CameraLost)
    stubborn = device(0, "stubborn", serial=mortal.serial)
    stage.wait(lambda: "ExposureTime" in camera.health().message and next_try_in_s(camera) > 5)
    assert not camera.health().connected
    assert "cable" not in camera.health().action, "the action is not the one for a lost camera"
    due_s = camera.health().next_try_s
    stubborn.unplug()
    stage.wait(lambda: "there is no camera" in camera.health().message)
    mortal.plug()
    assert stage.until(CameraBack).at_s < (due_s or 0.0)
    assert camera.health().next_try_s is None


def next_try_in_s(camera: AravisCamera) -> float:
    return (camera.health().next_try_s or 0.0) - time.monotonic()


def test_a_camera_that_another_has_taken_was_lost_before_aravis_asked_again(
    device: Plug, station: Make, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = device(0)
    stage = opened(station(camera))
    checks = itertools.count(1)
    taken_s: list[float] = []

    def is_controller(_connection: Connection) -> bool:
        """Lose the control after three checks, once."""
        if next(checks) == 4:
            taken_s.append(time.monotonic())
            return False
        return True

    monkeypatch.setattr(Connection, "is_controller", is_controller)
    assert stage.until(CameraLost).since_s <= taken_s[0]
    stage.until(CameraBack)


def test_a_camera_that_dies_again_and_again_leaves_nothing_behind(device: Plug, station: Make, opened: Open) -> None:
    mortal = device(0)
    stage = opened(station(mortal))
    counts: list[int] = []
    for _ in range(4):
        mortal.unplug()
        stage.until(CameraLost)
        mortal.plug()
        stage.until(CameraBack)
        wait_for_remains()
        counts.append(len(held()))
        stage.wait(lambda: len(held()) <= counts[0])


def held() -> list[str]:
    """Descriptors of this process and threads of its cameras; a clock that is just being read has one more."""
    descriptors = [str(path) for path in Path("/proc/self/fd").iterdir()]
    return descriptors + [name for name in thread_names() if name.startswith(("arv", "camera"))]

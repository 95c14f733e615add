"""Tests of the feedback to a fast replay, and of the order in which devices are closed."""

from __future__ import annotations

import threading
from typing import Any

from vaoi_station.acquisition.devices import Devices, Feedback

TIMEOUT_S = 10.0


def test_a_stop_ends_all_waiting_after_wake() -> None:
    feedback, stop = Feedback(), threading.Event()
    feedback.expect_frames(1)
    waiters = [
        threading.Thread(target=feedback.wait_for_memory, args=(stop.is_set,)),
        threading.Thread(target=feedback.wait_for_frames, args=(stop.is_set,)),
    ]
    for waiter in waiters:
        waiter.start()
    stop.set()
    feedback.wake()
    for waiter in waiters:
        waiter.join(TIMEOUT_S)
        assert not waiter.is_alive()


def test_the_controller_is_closed_before_the_cameras() -> None:
    closed: list[str] = []

    class Device:
        def __init__(self, name: str) -> None:
            self.name = name

        def close(self) -> None:
            closed.append(self.name)

        def threads(self) -> tuple[str, ...]:
            return (f"{self.name}'s thread",)

    devices: Any = Devices((Device("camera 0"), Device("camera 1")), Device("controller"))  # type: ignore[arg-type]
    assert devices.threads() == ("controller's thread", "camera 0's thread", "camera 1's thread")
    devices.close()
    assert closed == ["controller", "camera 0", "camera 1"]

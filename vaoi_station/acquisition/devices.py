"""The devices of a station, and what a fast replay must hear of the one who takes the frames."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from vaoi_station.acquisition.cameras.interface import CameraDevice
from vaoi_station.acquisition.controller.interface import Controller


class Feedback:
    """What a replay that goes as fast as it can must know of the one who takes the frames."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._done = 0
        self._memory = False

    def frame_done(self) -> None:
        """One more frame has found its place (or has been refused one)."""
        with self._change:
            self._done += 1
            self._change.notify_all()

    def memory(self, there: bool) -> None:
        """Whether the cameras hold memory for a coming run."""
        with self._change:
            self._memory = there
            self._change.notify_all()

    def frames_done(self) -> int:
        """How many frames were done so far."""
        return self._done

    def wait_done(self, count: int, stop: Callable[[], bool], timeout_s: float) -> None:
        """Until so many frames are done, or `stop()`."""
        with self._change:
            self._change.wait_for(lambda: self._done >= count or stop(), timeout_s)

    def wait_memory(self, stop: Callable[[], bool]) -> None:
        """Until there is memory for a run, or `stop()`."""
        with self._change:
            self._change.wait_for(lambda: self._memory or stop())

    def wake(self) -> None:
        """Let waiters look at their `stop` again."""
        with self._change:
            self._change.notify_all()


@dataclass(frozen=True)
class Devices:
    """Opened, not started yet."""

    cameras: tuple[CameraDevice, ...]
    controller: Controller
    feedback: Feedback = field(default_factory=Feedback)

    def close(self) -> None:
        """The controller first: no pulse without cameras."""
        self.controller.close()
        for camera in self.cameras:
            camera.close()

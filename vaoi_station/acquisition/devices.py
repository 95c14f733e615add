"""The opened devices of a station, and the progress of the session, to which a fast replay adjusts its pace."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from vaoi_station.acquisition.cameras.interface import CameraDevice
from vaoi_station.acquisition.controller.interface import Controller
from vaoi_station.supervised_thread import SupervisedThread


class Feedback:
    """The session's progress: the count of processed frames, and whether memory is available for a run.

    A fast replay waits for this progress before it delivers the next row. Several threads may use the object.
    """

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._done = 0
        self._has_memory = False

    def frame_done(self) -> None:
        """Count one more frame that was either assigned to a row or refused."""
        with self._change:
            self._done += 1
            self._change.notify_all()

    def set_memory(self, available: bool) -> None:
        """Set whether memory is available for a run, that is, whether the cameras hold slots."""
        with self._change:
            self._has_memory = available
            self._change.notify_all()

    def frames_done(self) -> int:
        """Return the count of frames that were assigned or refused."""
        return self._done

    def wait_for_frames(self, count: int, stop: Callable[[], bool], timeout_s: float) -> None:
        """Wait until at least `count` frames are done, until `stop()` is true, or until `timeout_s` has passed."""
        with self._change:
            self._change.wait_for(lambda: self._done >= count or stop(), timeout_s)

    def wait_for_memory(self, stop: Callable[[], bool]) -> None:
        """Wait until memory is available for a run, or until `stop()` is true."""
        with self._change:
            self._change.wait_for(lambda: self._has_memory or stop())

    def wake(self) -> None:
        """Wake all waiting threads, so that each evaluates its function `stop` again."""
        with self._change:
            self._change.notify_all()


@dataclass(frozen=True)
class Devices:
    """The cameras and the controller of a station, opened but not started."""

    cameras: tuple[CameraDevice, ...]
    controller: Controller
    feedback: Feedback = field(default_factory=Feedback)

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the threads of all devices, which must neither end nor hang while the devices are open."""
        return (*self.controller.threads(), *(thread for camera in self.cameras for thread in camera.threads()))

    def close(self) -> None:
        """Close cameras and controller."""
        # The controller is closed first: it must not fire a pulse without cameras.
        self.controller.close()
        for camera in self.cameras:
            camera.close()

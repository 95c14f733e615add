"""The opened devices of a station, and the progress of the session, to which a fast replay adjusts its pace."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from vaoi_station.acquisition.cameras.interface import CameraDevice
from vaoi_station.acquisition.controller.interface import Controller
from vaoi_station.supervised_thread import SupervisedThread

ROW_TIMEOUT_S = 2.0
"""Longest time for which a fast replay waits until the frames of a row are processed, s."""
Stop = Callable[[], bool]
"""Whether a wait must end early; evaluated anew at every change, and after `Feedback.wake`."""


class Feedback:
    """The session's progress, to which a fast replay adjusts its pace. Several threads may use the object."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._done = self._expected = 0
        """Frames that were assigned or refused, and how many of them there must be before the next pulse."""
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

    def expect_frames(self, frames: int) -> None:
        """Await `frames` more frames before the next pulse."""
        self._expected += frames

    def wait_for_memory(self, stop: Stop) -> None:
        """Wait until there is memory for a run, which begins with all frames done."""
        with self._change:
            self._change.wait_for(lambda: self._has_memory or stop())
            self._expected = self._done

    def wait_for_frames(self, stop: Stop) -> None:
        """Wait until all expected frames are done, at most `ROW_TIMEOUT_S`: a frame without a slot is never done."""
        with self._change:
            self._change.wait_for(lambda: self._done >= self._expected or stop(), ROW_TIMEOUT_S)

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

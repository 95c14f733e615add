"""The newest frame of every camera, and looks at them: taken when somebody asks, each once."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2

from vaoi_station.errors import GoneError
from vaoi_station.files.images import Image, encode_jpeg
from vaoi_station.viewing.image_quality import full_scale
from vaoi_station.viewing.inspection import FrameInspection, inspect_frame
from vaoi_station.viewing.mark_spec import MarkSpec

_KEPT = 3
"""Looks per camera whose picture can still be fetched."""


@dataclass(eq=False)
class ViewedFrame:
    """One frame that was taken, and what is found in it when somebody asks."""

    camera: int
    run: str
    row: int
    number: int
    pixels: Image
    spec: MarkSpec | None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def look(self) -> FrameInspection:
        """ImageQuality and marks; worked out once."""
        with self._lock:
            return self._look

    @cached_property
    def _look(self) -> FrameInspection:
        return inspect_frame(self.pixels, self.spec)

    def jpeg(self) -> bytes:
        """As a picture of 8 bit."""
        if self.pixels.dtype == "uint8":
            return encode_jpeg(self.pixels, 85)
        return encode_jpeg(cv2.convertScaleAbs(self.pixels, alpha=255 / full_scale(self.pixels)), 85)


class LatestFrames:
    """Frames come in from the film, looks go out to the page; safe for threads."""

    def __init__(self, specs: Sequence[MarkSpec | None]) -> None:
        """One spec of marks per camera."""
        self._specs = tuple(specs)
        self._newest: dict[int, ViewedFrame] = {}
        self._looked: dict[int, list[ViewedFrame]] = {n: [] for n in range(len(specs))}
        self._count = 0
        self._change = threading.Condition()

    def put(self, camera: int, run: str, row: int, pixels: Image) -> None:
        """A frame has come; it is kept until a newer one does."""
        with self._change:
            self._count += 1
            self._newest[camera] = ViewedFrame(camera, run, row, self._count, pixels, self._specs[camera])
            self._change.notify_all()

    def wait(self, after: int, timeout_s: float) -> int:
        """Number of the newest frame, when it is beyond `after` or the time is over."""
        with self._change:
            self._change.wait_for(lambda: self._count > after, timeout_s)
            return self._count

    def shots(self) -> list[ViewedFrame]:
        """The newest of every camera that has one; their pictures stay to be fetched for a while."""
        with self._change:
            out = [self._newest[n] for n in sorted(self._newest)]
            for shot in out:
                kept = self._looked[shot.camera]
                if shot not in kept:
                    kept.append(shot)
                    del kept[:-_KEPT]
            return out

    def shot(self, camera: int, number: int) -> ViewedFrame:
        """A frame that was shown; GoneError if newer ones have taken its place."""
        with self._change:
            found = next((s for s in self._looked.get(camera, []) if s.number == number), None)
        if found is None:
            raise GoneError(f"frame {number} of camera {camera} is not kept any more.", action="Ask for a newer one.")
        return found

"""The latest frame of every camera; each frame is inspected only once, when it is first requested."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2

from vaoi_station.errors import GoneError
from vaoi_station.files.images import Image, encode_jpeg
from vaoi_station.photometry.image_quality import full_scale
from vaoi_station.viewing.inspection import FrameInspection, inspect_frame
from vaoi_station.viewing.mark_spec import MarkSpec

_KEPT = 3
"""Number of listed frames per camera whose pictures can still be fetched."""


@dataclass(eq=False)
class ViewedFrame:
    """One frame with its inspection, which is computed on first access."""

    camera: int
    run: str
    row: int
    number: int
    pixels: Image
    spec: MarkSpec | None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def inspection(self) -> FrameInspection:
        """Image quality, marks and remarks of the frame, computed on first access."""
        # Two requests may come at the same time. The second one waits until the first has encoded the picture.
        with self._lock:
            return self._inspection

    @cached_property
    def _inspection(self) -> FrameInspection:
        return inspect_frame(self.pixels, self.spec)

    def jpeg(self) -> bytes:
        """Encode the frame as JPEG, scaled to 8 bit."""
        if self.pixels.dtype == "uint8":
            return encode_jpeg(self.pixels, 85)
        return encode_jpeg(cv2.convertScaleAbs(self.pixels, alpha=255 / full_scale(self.pixels)), 85)


class LatestFrames:
    """The latest frame of every camera, written by the filming thread and read by the page; thread-safe."""

    def __init__(self, specs: Sequence[MarkSpec | None]) -> None:
        """Take one mark specification per camera; None for a camera in whose frames no marks are searched."""
        self._specs = tuple(specs)
        self._latest: dict[int, ViewedFrame] = {}
        self._listed: dict[int, list[ViewedFrame]] = {n: [] for n in range(len(specs))}
        self._count = 0
        self._change = threading.Condition()

    def put(self, camera: int, run: str, row: int, pixels: Image) -> None:
        """Store a frame as the latest of its camera."""
        with self._change:
            self._count += 1
            self._latest[camera] = ViewedFrame(camera, run, row, self._count, pixels, self._specs[camera])
            self._change.notify_all()

    def wait(self, after: int, timeout_s: float) -> int:
        """Wait until there is a frame numbered above `after`, or the time-out; return the newest frame's number."""
        with self._change:
            self._change.wait_for(lambda: self._count > after, timeout_s)
            return self._count

    def frames(self) -> list[ViewedFrame]:
        """Return the latest frame of every camera that has one."""
        # Listed frames are kept a little longer: the page fetches their pictures after it has received the list.
        with self._change:
            out = [self._latest[n] for n in sorted(self._latest)]
            for listed in out:
                kept = self._listed[listed.camera]
                if listed not in kept:
                    kept.append(listed)
                    del kept[:-_KEPT]
            return out

    def frame(self, camera: int, number: int) -> ViewedFrame:
        """Return a listed frame; raise GoneError if newer frames have replaced it."""
        with self._change:
            found = next((s for s in self._listed.get(camera, []) if s.number == number), None)
        if found is None:
            raise GoneError(f"frame {number} of camera {camera} is no longer kept.", action="Request a newer one.")
        return found

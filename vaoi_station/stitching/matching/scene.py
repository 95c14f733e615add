"""The frames of a run, for those stages of the conclusion that read pixels again after all links are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vaoi_station.geometry import Camera
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame


@dataclass(frozen=True, eq=False)
class Scene:
    """The cameras and good frames of a run, with access to the prepared frames."""

    cameras: tuple[Camera, ...]
    present: tuple[FrameKey, ...]
    """Camera and row of every good frame, sorted."""
    prepared: Callable[[FrameKey], PreparedFrame]
    """A function that returns the prepared frame of a camera and row, and raises LookupError if it is missing."""
    doubts: tuple[str, ...] = ()
    """Doubts about the frames that arose when they were recorded (`RecordingHead.doubts`)."""

"""What the last stage of stitching may look at: cameras, good frames, and their prepared pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vaoi_station.geometry import Camera
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame


@dataclass(frozen=True, eq=False)
class Scene:
    """The frames of a run, for second looks."""

    cameras: tuple[Camera, ...]
    present: tuple[FrameKey, ...]
    prepared: Callable[[FrameKey], PreparedFrame]

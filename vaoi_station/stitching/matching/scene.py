"""The frames of a run, for the stages that read pixels again after all links are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vaoi_station.geometry import Camera
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame


@dataclass(frozen=True, eq=False)
class Scene:
    """Cameras, good frames, and access to their prepared pixels."""

    cameras: tuple[Camera, ...]
    present: tuple[FrameKey, ...]
    """The good frames, sorted."""
    prepared: Callable[[FrameKey], PreparedFrame]
    """Returns a frame; raises LookupError where there is none."""

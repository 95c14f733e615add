"""Tasks, and the evidence they return: which point of one image is which of another, and where marks are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats

FrameKey = tuple[int, int]
"""Camera and row."""


class Task(NamedTuple):
    """One independent piece of work on one or two frames; a tuple, for a large board's 1200 are looked up often."""

    kind: Literal["rows", "neighbours", "marks", "reference"]
    a: FrameKey
    b: FrameKey | None = None
    """The second frame; of the reference run, where the kind is "reference"."""
    dt_s: float = 0.0
    """Time between the two frames."""


@dataclass(frozen=True, eq=False)
class Links:
    """Points of frame `task.a` found again in frame `task.b`; blind to CAD, with points to spare."""

    task: Task
    a_px: Floats
    """(k, 2) raw pixels in frame a."""
    b_px: Floats
    """(k, 2) raw pixels in frame b."""
    information: Floats
    """(k, 2, 2) inverse covariance of b_px − a_px by image noise, px⁻²: an edge is sure only across."""
    score: Floats
    """(k,) zero-mean normalised correlation at the place found."""
    note: str = ""
    """Why there are none, or few."""
    coarse_px: tuple[float, float] | None = None
    """Where the coarse search found the motion to differ from the nominal one."""
    tried: int = 0
    """How many places were looked for."""
    unmatched: bool = False
    """The overlap of two cameras shows texture, but little or none of it is in both frames."""

    @staticmethod
    def empty(task: Task, note: str, tried: int = 0) -> Links:
        """Evidence of having looked, at so many places, and found nothing."""
        return Links(task, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), note, tried=tried)


@dataclass(frozen=True, eq=False)
class Detections:
    """Places in one frame that look like a fiducial of the board type."""

    task: Task
    px: Floats
    """(k, 2) raw pixels."""
    sigma_px: Floats
    """(k,) standard deviation of the place."""
    score: Floats
    """(k,) correlation with the artwork."""
    kind: np.ndarray
    """(k,) index into `mark_kinds(board_type)`."""


Evidence = Links | Detections

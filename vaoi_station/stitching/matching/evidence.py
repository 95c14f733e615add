"""Tasks and the evidence they return: links between two frames, and detections of marks in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats

FrameKey = tuple[int, int]
"""Camera and row."""


class Task(NamedTuple):
    """Independent work on one or two frames.

    It is a tuple because it is a key: the 1200 tasks of a large board are looked up often, and tuples hash fastest.
    """

    kind: Literal["rows", "neighbours", "marks", "reference"]
    a: FrameKey
    b: FrameKey | None = None
    """The second frame; for the kind "reference" a frame of the reference run."""
    dt_s: float = 0.0
    """Time between the two frames."""


@dataclass(frozen=True, eq=False)
class Links:
    """k pairs of corresponding points in the frames `task.a` and `task.b`, found without CAD data."""

    task: Task
    a_px: Floats
    """(k, 2) raw pixels in frame a."""
    b_px: Floats
    """(k, 2) raw pixels in frame b."""
    information: Floats
    """(k, 2, 2) inverse covariance of b_px − a_px by image noise, px⁻²; small along an edge, large across it."""
    score: Floats
    """(k,) zero-mean normalised correlation of the patches."""
    note: str = ""
    """The reason why there are none."""
    coarse_px: tuple[float, float] | None = None
    """Difference of the coarse search from the nominal motion."""
    tried: int = 0
    """The number of corners that were searched for."""
    unmatched: bool = False
    """Whether the overlap of two cameras shows texture of which little or nothing is in both frames."""

    @staticmethod
    def empty(task: Task, note: str, tried: int = 0) -> Links:
        """Return the evidence of a task that found no link among the corners it tried."""
        return Links(task, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), note, tried=tried)


@dataclass(frozen=True, eq=False)
class Detections:
    """k places in one frame that look like a fiducial of the board type."""

    task: Task
    px: Floats
    """(k, 2) raw pixels."""
    sigma_px: Floats
    """(k,) standard deviation of `px`."""
    score: Floats
    """(k,) correlation with the artwork."""
    kind: np.ndarray
    """(k,) index into `mark_kinds(board_type)`."""


Evidence = Links | Detections

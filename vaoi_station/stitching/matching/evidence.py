"""Tasks, the evidence they return, and the evidence that each method of stitching may use (paper, 3.3.1 to 3.3.3)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from vaoi_station.config import MethodName
from vaoi_station.geometry.transforms import Floats

FrameKey = tuple[int, int]  # the address of a frame: camera and row


class Task(NamedTuple):
    """Independent work on one or two frames that yields evidence: links between two frames, or detections in one.

    A task is a tuple because it is used as a key. A large board has 1200 tasks, and tuples hash fastest.
    """

    kind: Literal["rows", "neighbours", "marks", "reference"]
    a: FrameKey
    b: FrameKey | None = None
    """The second frame. It is a frame of the reference run if `kind` is "reference", and None if `kind` is "marks"."""
    dt_s: float = 0.0  # time from the pulse of frame a to the pulse of frame b. Only linking two rows ("rows") uses it


@dataclass(frozen=True, eq=False)
class Links:
    """k links: pairs of corresponding points in the frames `task.a` (frame a) and `task.b` (frame b)."""

    task: Task
    a_px: Floats  # (k, 2) raw pixels in frame a
    b_px: Floats  # (k, 2) raw pixels in frame b
    information: Floats
    """(k, 2, 2) information matrix, px⁻²: the inverse covariance of b_px − a_px that image noise causes. It is small
    along an edge and large across it."""
    score: Floats  # (k,) correlation of the two patches, from −1 to 1, after their means are subtracted
    note: str = ""  # text that states why there are no links; empty if there are links
    coarse_px: tuple[float, float] | None = None
    """Shift that the coarse search added to the predicted one; None if no links were found."""
    tried: int = 0  # the number of corners of frame a that were searched in frame b
    unmatched: bool = False
    """Whether the overlap of two cameras shows texture of which hardly any was found in both frames."""

    rival_px: tuple[float, float] | None = None
    """A different shift at which the coarse search found a similar fit; None if there is none."""
    ambiguous: bool = False
    """Whether a repeated pattern fits as well at another motion of the board that the belt may have made."""

    copied: bool = False
    """Whether frame b equals frame a in every pixel: the camera sent one frame twice, and frame b does not show its
    row."""

    @property
    def rows(self) -> tuple[int, int]:
        """The rows of the two frames: twice the same between two cameras."""
        return self.task.a[1], (self.task.b or self.task.a)[1]

    @staticmethod
    def empty(task: Task, note: str, tried: int = 0) -> Links:
        """Return the evidence of a task that found no link among the corners it tried."""
        return Links(task, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), note, tried=tried)


@dataclass(frozen=True, eq=False)
class Detections:
    """k detections in the frame `task.a`: places that look like a fiducial of the board type."""

    task: Task
    px: Floats  # (k, 2) positions of the detections in raw pixels
    sigma_px: Floats  # (k,) standard deviation of `px`, per axis, in px
    score: Floats  # (k,) correlation of the pixels with the expected picture of the mark
    kind: np.ndarray  # (k,) kind of mark of each detection: index into the list that `mark_kinds(board_type)` returns


Evidence = Links | Detections
RowsLinks = Mapping[tuple[int, int], tuple[Links, ...]]
"""The links of a run by their rows p and q, ordered by q, then by p, and those of two rows by camera."""


def by_rows(links: Iterable[Links]) -> RowsLinks:
    """Arrange the links of a run by their rows."""
    out: dict[tuple[int, int], list[Links]] = {}
    for e in links:
        (_, q), (_, p) = e.task.b or e.task.a, e.task.a
        if (q, p) in out:
            out[q, p].append(e)
        else:
            out[q, p] = [e]
    return {(p, q): tuple(sorted(out[q, p], key=lambda e: e.task.a)) for q, p in sorted(out)}


__all__ = ["METHODS", "Method", "MethodName"]


@dataclass(frozen=True)
class Method:
    """The kinds of evidence that a stitching method may use."""

    links: bool  # whether to use texture that is linked from row to row and from camera to camera
    marks: bool  # whether to use the fiducials of the board
    fixture: bool  # whether to use the fixture marks
    reference: bool  # whether to use texture that is linked to a reference run of the same board type


METHODS: dict[str, Method] = {
    "auto": Method(links=True, marks=True, fixture=True, reference=True),
    "features": Method(links=True, marks=True, fixture=False, reference=False),
    "fiducials": Method(links=False, marks=True, fixture=True, reference=False),
    "reference": Method(links=False, marks=False, fixture=False, reference=True),
}

"""Which good frames are confirmed: their pictures show that they belong to the row in which they are.

A frame that is black, covered, frozen or in a wrong row can be complete. It does not fit the board's motion, and no
component counts as seen in it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Observations
from vaoi_station.stitching.adjustment.problem import REFERENCE, AdjustmentResult, FiducialPoints
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.method import Method

_USED = 0.1
"""Weight above which a link counts as used."""
_LEAST_FITTING, _LEAST_SHARE, _DECIDING = 3, 0.5, 5
"""Least number and share of a frame's links or points that must fit; number of them that decides it.

In sound frames of recordings and twin, a share of 0.7 or more fits. In a picture of another row, up to 7 of 31 fit by
chance: a board has equal parts at equal distances."""
_SURE = 12
"""Number of fitting links from which no picture of another row is to be expected."""
_BESIDE_SHARE = 0.7
"""Least share of the links beside the board that must fit where they alone confirm a frame."""
_BESIDE_MM, _BESIDE_OF_WAY = 0.05, 0.02
"""Largest residual of a link beside the board: constant, and per mm of the way between its rows.

The carrier or the belt may lie below the board by 2 % of the working distance, so that its pictures move less."""
_ALIKE_MM = 0.05
"""Largest deviation of such a residual from the median of its pair of frames.

What lies beside the board is one plane, so that all residuals of a pair are alike: of sound frames of hostile drawings,
0.98 and more. Along an edge of the carrier, links of a frame of another row fit by chance, but differ."""


class _Fits(NamedTuple):
    """Links of a frame, and those of them that fit the board's motion."""

    every: int = 0
    fitting: int = 0

    @property
    def enough(self) -> bool:
        """Whether as many links fit as a frame of this row must have."""
        return self.fitting >= _LEAST_FITTING and self.fitting >= _LEAST_SHARE * self.every

    def plus(self, every: int, fitting: int) -> _Fits:
        return _Fits(self.every + every, self.fitting + fitting)


class CheckedFrames(NamedTuple):
    """The good frames of a run by what their pictures show. Those that show too little are in neither set."""

    confirmed: frozenset[FrameKey]
    """Frames that fit the board's motion."""
    refuted: frozenset[FrameKey]
    """Frames that show another part of the board than their row: they are copies, or most of their links contradict."""
    sure: frozenset[FrameKey] = frozenset()
    """Confirmed frames of which more fits than may fit by chance."""
    repeated: frozenset[FrameKey] = frozenset()
    """Refuted frames that show the moment of the frame before, in other pixels."""

    def plus(self, confirmed: frozenset[FrameKey]) -> CheckedFrames:
        """Return the same with further frames confirmed."""
        return self._replace(confirmed=self.confirmed | confirmed)

    def without(self, repeated: frozenset[FrameKey]) -> CheckedFrames:
        """Return the same with frames refuted that show the moment of the frame before."""
        return CheckedFrames(self.confirmed - repeated, self.refuted | repeated, self.sure, repeated)


def check_frames(
    present: frozenset[FrameKey],
    copies: frozenset[FrameKey],
    method: Method,
    adjusted: AdjustmentResult,
    beside: Observations | None,
) -> CheckedFrames:
    """Check what the good frames show against the board's motion.

    Args:
        present: the good frames.
        copies: those that equal the frame before in every pixel.
        method: the kinds of evidence that were used.
        adjusted: the solution, with the problem that it solves.
        beside: the links beside the board, which the adjustment left out; None if it left out none.
    """
    points, possible = adjusted.problem.fiducials, present - copies
    frames, decided = confirmed_by_points(points, adjusted.fiducial_px) if points is not None else (set(), set())
    sure = set(frames)
    if method.links:
        sure |= _sure(adjusted.problem.links, adjusted.weight)
        fitting, with_links = confirmed_by_links(adjusted.problem.links, adjusted.weight)
        frames, decided = frames | fitting, decided | with_links
        if beside is not None:
            frames |= confirmed_beside(beside, adjusted.motion, possible - frames - decided)
    elif method.marks:
        # Marks are far apart: nothing could confirm a frame between two of them.
        return CheckedFrames(possible, copies & present, possible)
    confirmed = frozenset(frames & possible)
    refuted = frozenset((copies | decided) & present - confirmed)
    return CheckedFrames(confirmed, refuted, confirmed & sure)


def confirmed_by_links(links: Observations, weight: NDArray[np.float64]) -> tuple[set[FrameKey], set[FrameKey]]:
    """Return the frames that links on the board confirm, and those with enough links to decide it.

    Args:
        links: the k links on the board.
        weight: (k,) their robust weights in the adjustment.
    """
    frames = _fits(links, weight > _USED)
    return _enough(frames), _decided(frames)


def confirmed_by_points(
    points: FiducialPoints, residual_px: NDArray[np.float64]
) -> tuple[set[FrameKey], set[FrameKey]]:
    """Return the frames that points with CAD coordinates confirm, and those with enough of them to decide it.

    One mark of the board confirms a frame, or points of the reference.

    Args:
        points: the k points.
        residual_px: (k, 2) their residuals in the adjustment.
    """
    fits, of_reference = inliers(points, residual_px), points.which == REFERENCE
    frames: defaultdict[FrameKey, _Fits] = defaultdict(_Fits)
    marked = set[FrameKey]()
    for camera, row, fit, by_reference in np.column_stack([points.camera, points.row, fits, of_reference]).tolist():
        if by_reference:
            frames[camera, row] = frames[camera, row].plus(1, fit)
        elif fit:
            marked.add((camera, row))
    # Parts at equal distances let single points of the reference fit by chance.
    return marked | _enough(frames), _decided(frames)


def confirmed_beside(beside: Observations, motion: Motion, undecided: Collection[FrameKey]) -> set[FrameKey]:
    """Return those of the undecided frames whose links beside the board fit the motion of the board.

    A carrier moves with the board, and a belt nearly so. A frame at the end of a board may show little else: its few
    links on the board decide nothing then, but what lies beside the board shows that the frame is of its row.

    Args:
        beside: the links beside the board, which the adjustment left out.
        motion: motion of the board.
        undecided: frames with too few links on the board.
    """
    # The height of what lies beside the board is not known. It displaces links between cameras too far to compare them.
    links = beside.select(np.flatnonzero(beside.p != beside.q))
    if not undecided or not len(links):
        return set()
    apart_mm = motion.board(links.p, links.a_mm) - motion.board(links.q, links.b_mm)
    way_mm = np.hypot(*(links.a_mm - links.b_mm).T)
    fits = np.hypot(*apart_mm.T) <= _BESIDE_MM + _BESIDE_OF_WAY * way_mm
    for group in np.unique(links.group):
        mine = links.group == group
        fits[mine] &= np.hypot(*(apart_mm[mine] - np.median(apart_mm[mine], axis=0)).T) <= _ALIKE_MM
    return {
        key
        for key, one in _fits(links, fits).items()
        if key in undecided and one.fitting >= _DECIDING and one.fitting >= _BESIDE_SHARE * one.every
    }


def linked_to_before(links: Observations, weight: NDArray[np.float64]) -> set[FrameKey]:
    """Return the frames of which a used link leads to the frame before; `weight` (k,) are the links' robust weights."""
    used = {links.groups[n].task for n in np.unique(links.group[weight > _USED]).tolist()}
    return {t.b for t in used if t.b is not None and t.kind == "rows" and t.b == (t.a[0], t.a[1] + 1)}


def _sure(links: Observations, weight: NDArray[np.float64]) -> set[FrameKey]:
    """Return the frames of which more links fit than may fit by chance."""
    return {key for key, one in _fits(links, weight > _USED).items() if one.fitting >= _SURE}


def _enough(frames: Mapping[FrameKey, _Fits]) -> set[FrameKey]:
    return {key for key, one in frames.items() if one.enough}


def _decided(frames: Mapping[FrameKey, _Fits]) -> set[FrameKey]:
    return {key for key, one in frames.items() if one.every >= _DECIDING}


def _fits(links: Observations, fit: NDArray[np.bool_]) -> dict[FrameKey, _Fits]:
    """Count the links of every frame, and those that fit."""
    count = len(links.groups)
    every, fitting = np.bincount(links.group, minlength=count), np.bincount(links.group[fit], minlength=count)
    frames: defaultdict[FrameKey, _Fits] = defaultdict(_Fits)
    for group, own, fits in zip(links.groups, every.tolist(), fitting.tolist(), strict=True):
        for key in (group.task.a, group.task.b):
            if key is not None:
                frames[key] = frames[key].plus(own, fits)
    return frames

"""Which good frames are confirmed: their pictures show that they belong to the row in which they are.

A frame that is black, covered, frozen or in a wrong row can be complete. It does not fit the board's motion, and no
component counts as seen in it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Observations
from vaoi_station.stitching.matching.evidence import FrameKey

_USED = 0.1
"""Weight above which a link counts as used."""
_LEAST_FITTING, _LEAST_SHARE, _SURELY = 3, 0.25, 5
"""Least number and share of a frame's links that must fit the board's motion; number that always suffices.

In sound frames of recordings and twin, a share of 0.7 or more fits. In a repeated one, one link may fit by chance."""
_BESIDE_SHARE = 0.7
"""Least share of the links beside the board that must fit where they alone confirm a frame."""
_BESIDE_MM, _BESIDE_OF_WAY = 0.05, 0.02
"""Largest residual of a link beside the board: constant, and per mm of the way between its rows.

The carrier or the belt may lie below the board by 2 % of the working distance, so that its pictures move less."""


class _Fits(NamedTuple):
    """Links of a frame, and those of them that fit the board's motion."""

    every: int = 0
    fitting: int = 0

    def plus(self, every: int, fitting: int) -> _Fits:
        return _Fits(self.every + every, self.fitting + fitting)


def confirmed_by_links(links: Observations, weight: NDArray[np.float64]) -> tuple[set[FrameKey], set[FrameKey]]:
    """Return the frames that links on the board confirm, and those with enough links to decide it.

    Args:
        links: the k links on the board.
        weight: (k,) their robust weights in the adjustment.
    """
    frames = _fits(links, weight > _USED)
    # Most links of a frame at the end of the board may lie on a textured belt.
    fitting = {
        key
        for key, (every, fits) in frames.items()
        if fits >= _SURELY or (fits >= _LEAST_FITTING and fits > _LEAST_SHARE * every)
    }
    return fitting, {key for key, one in frames.items() if one.every >= _SURELY}


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
    apart_mm = np.hypot(*(motion.board(links.p, links.a_mm) - motion.board(links.q, links.b_mm)).T)
    way_mm = np.hypot(*(links.a_mm - links.b_mm).T)
    fits = apart_mm <= _BESIDE_MM + _BESIDE_OF_WAY * way_mm
    return {
        key
        for key, one in _fits(links, fits).items()
        if key in undecided and one.fitting >= _SURELY and one.fitting >= _BESIDE_SHARE * one.every
    }


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

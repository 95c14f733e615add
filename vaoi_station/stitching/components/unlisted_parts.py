"""Parts that stand on the board where the board type has none: they show a board of another type.

Fiducials and outline of two board types may be the same. Their parts are not: corners of a part that the board type
does not list move from row to row as points above the bare board do. A list without connectors causes the same, so
the parts are a reason only if too few components show their centres where C puts them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.own_texture import links_on_board

_HIGH_MM, _HIGH_SIGMAS, _WORST_MM = 0.3, 4.0, 0.25
"""A corner stands above the bare board from this height on, in mm and in standard deviations. Heights with a larger
standard deviation than the last value are left out."""
_ASIDE = 3.5
"""Links with a larger residual than this in the direction that no height explains are left out; in standard
deviations."""
_LEAST_FLOOR_PX = 0.01
"""Least scatter of a link beyond image noise: that of single points on copper and silkscreen."""
_PLACE_MM = 2.0
"""Corners in one square of this size belong to one part."""
_DIGITS = {"mm": 1, "mil": 0, "inch": 2}
"""Number of decimals of a place in each unit of CAD data."""
_LEAST_PLACES, _LEAST_SHARE, _SUNK = 3, 0.03, 1 / 3
"""Least number of places, least share of corners on the bare board that stand above it, and largest ratio of those that
seem to lie below it.

On boards of their own type, in 106 drawings of the hostile suite whose components show no centres and in the recorded
cases, the share is 0.9 % at most; on boards of another type it is 8 % in the median (docs/measured/uncertainty.md)."""


class UnlistedParts(NamedTuple):
    """Corners on what should be the bare board."""

    bare: int
    """Number of corners whose height is known."""
    raised: int
    """Number of those that stand above the board."""
    sunk: int
    """Number of those that seem to lie below it: false links do both alike."""
    places: Floats
    """(n, 2) CAD coordinates of places where corners stand above the board."""

    @property
    def other_type(self) -> bool:
        """Whether parts stand where a board of this type has none."""
        enough = len(self.places) >= _LEAST_PLACES and self.raised > _LEAST_SHARE * self.bare
        return enough and self.sunk <= _SUNK * self.raised


def find_unlisted_parts(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> UnlistedParts:
    """Find corners above the bare board, from links between rows away from components and from the outline.

    Args:
        plane: plane of the board type.
        problem: the problem of the adjustment, with placed components.
        adjusted: its solution.
    """
    o, motion, c = problem.links, adjusted.motion, adjusted.similarity
    nothing = UnlistedParts(0, 0, 0, np.zeros((0, 2)))
    if problem.surface is None or c is None or not len(adjusted.surface_mm) or not len(o):
        return nothing
    # Without an outline of the board itself, what stands on a carrier or beside the board would count.
    if plane.board_type.outline is None or plane.board_type.fixture_marks:
        return nothing
    on_board = links_on_board(plane, c, o, motion, float(np.median(o.px_per_mm)))
    bare = (problem.component < 0) & ~problem.reaches_component & (o.p != o.q)
    at = on_board[bare[on_board]]
    surface_mm = (problem.surface.at_links[at] @ adjusted.surface_mm)[:, None]
    lean = motion.turned(o.p[at], o.a_lean[at])
    change = motion.turned(o.q[at], o.b_lean[at]) - lean
    place = motion.board(o.p[at], o.a_mm[at]) + lean * surface_mm
    residual = motion.board(o.q[at], o.b_mm[at]) - motion.board(o.p[at], o.a_mm[at]) + change * surface_mm
    floor = (max(adjusted.floor_px, _LEAST_FLOOR_PX) / o.px_per_mm[at]) ** 2
    weight = np.linalg.inv(o.noise_mm2[at] + floor[:, None, None] * np.eye(2))
    # The height by each link, as in `quality/heights.py`.
    weighted = np.einsum("kij,kj->ki", weight, change)
    information = np.maximum((change * weighted).sum(1), 1e-9)
    height, sigma = -(weighted * residual).sum(1) / information, 1 / np.sqrt(information)
    rest = residual + change * height[:, None]
    known = (sigma < _WORST_MM) & (np.einsum("ki,kij,kj->k", rest, weight, rest) < _ASIDE**2)
    limit = np.maximum(_HIGH_SIGMAS * sigma, _HIGH_MM)
    raised = known & (height > limit)
    squares = np.unique(np.floor(place[raised] / _PLACE_MM), axis=0)
    places = apply(np.linalg.inv(plane.matrix(c)), (squares + 0.5) * _PLACE_MM) if len(squares) else np.zeros((0, 2))
    return UnlistedParts(int(known.sum()), int(raised.sum()), int((known & (height < -limit)).sum()), places)


def unlisted_part_reasons(parts: UnlistedParts, plane: BoardPlane) -> list[Reason]:
    """Return a reason if parts stand where a board of this type has none."""
    if not parts.other_type:
        return []
    unit = plane.board_type.unit
    digits = _DIGITS[unit]
    where = ", ".join(f"({x:.{digits}f}, {y:.{digits}f})" for x, y in parts.places[:3].tolist())
    more = "" if len(parts.places) <= 3 else f" and {len(parts.places) - 3} more"
    return [
        Reason(
            ReasonCode.UNLISTED_PARTS,
            f"parts stand at about {len(parts.places)} places where board type {plane.board_type.name!r} has none ("
            f"{where}{more}, CAD coordinates in {unit}), and too few of its components are recognised at their "
            "places: the board is of another type; compare it with its order. If it is of this type, add the missing "
            "parts to the board type, or teach a reference",
        )
    ]

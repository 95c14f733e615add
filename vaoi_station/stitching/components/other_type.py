"""Whether the parts on a board show that it is of another type, whose fiducials and outline are the same.

Corners of a part that the board type does not list move from row to row as points above the bare board do; a list
without connectors causes the same, so that they count only if too few components show their centres where C puts them.
Against a reference, the picture of each component is correlated with its picture there: pads look alike even where
parts are absent or have other markings.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import REFERENCE, AdjustmentResult, FiducialPoints, Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.outline import links_on_board
from vaoi_station.stitching.board.reference import ReferenceScene, inliers
from vaoi_station.stitching.components.centres import PartView, reduced_patch, reduction
from vaoi_station.stitching.matching.frames import Scene

_LEAST = 5
"""Least number of components that shows that a board is of another type."""
_MARGIN_MM, _REACH_MM = 0.1, 0.1
"""Width of the rim around a footprint that is compared too, and largest distance, along each axis, of a part from its
place in the reference."""
_MOST_NODES = 20
"""Half the side of a compared patch in nodes, at most: shapes and shades are compared, not markings."""
_LEAST_CONTRAST, _ALIKE, _LEAST_SHARE = 4.0, 0.6, 0.3
"""Least standard deviation of the grey levels of a component in the reference; least correlation of two pictures that
look alike; least share of these on a board of the same type. Measured: hostile.md."""
_HIGH_MM, _HIGH_SIGMAS, _WORST_MM = 0.3, 4.0, 0.25
"""A corner stands above the bare board from this height on, in mm and in standard deviations. Heights with a larger
standard deviation than the last value are left out."""
_ASIDE, _LEAST_FLOOR_PX = 3.5, 0.01
"""Links with a larger residual, in standard deviations, in the direction that no height explains are left out; least
scatter of a link beyond image noise."""
_PLACE_MM = 2.0
"""Corners in one square of this size belong to one part."""
_DIGITS = {"mm": 1, "mil": 0, "inch": 2}
"""Number of decimals of a place in each unit of CAD data."""
_LEAST_PLACES, _LEAST_RAISED_SHARE, _SUNK = 3, 0.03, 1 / 3
"""Least number of places, least share of corners on the bare board that stand above it, and largest ratio of those that
seem to lie below it. Measured: 0.9 % on boards of their own type, 8 % on others (docs/explanation/uncertainty.md)."""


class Likeness(NamedTuple):
    """How many components were compared with the reference, and how many of them look alike."""

    compared: int
    alike: int

    @property
    def other_type(self) -> bool:
        """Whether the components show that the board is of another type than the reference."""
        return self.compared >= _LEAST and self.alike < _LEAST_SHARE * self.compared


def shown_by_points(plane: BoardPlane, points: FiducialPoints, residual_px: Floats) -> bool:
    """Return whether points of the reference that fit lie on enough components that these need no comparison."""
    fitting = inliers(points, residual_px) & (points.which == REFERENCE)
    on = plane.components.find(np.eye(3), plane.cad(points.cad[fitting]))
    return len(set(on[on >= 0].tolist())) >= _LEAST_SHARE * len(plane.components.addresses)


def compare_components(plane: BoardPlane, views: list[PartView], scene: Scene, reference: ReferenceScene) -> Likeness:
    """Compare components in the frames of a run with the same components in the same frames of the reference."""
    theirs, scores = reference.stitch.components or {}, []
    there = set(reference.scene.present)
    for view in views:
        known = theirs.get(plane.components.addresses[view.part], ())
        place = next((np.array(px) for i, j, *px in known if (i, j) == view.frame), None)
        if place is None or view.frame not in there:
            continue
        ours, other = (s.prepared(view.frame).grey for s in (scene, reference.scene))
        score = _correlation(ours, other, view, place, scene.cameras[view.frame[0]].px_per_mm)
        scores += [] if score is None else [score]
    return Likeness(len(scores), sum(score >= _ALIKE for score in scores))


def _correlation(
    ours: NDArray[np.uint8], theirs: NDArray[np.uint8], view: PartView, place: Floats, px_per_mm: float
) -> float | None:
    """Return the highest correlation of two pictures of a component; None without the whole of it or contrast."""
    half = [v + _MARGIN_MM * px_per_mm for v in view.half_px.tolist()]
    factor = reduction(half, _MOST_NODES)
    (u, v), reach = (math.ceil(h / factor) for h in half), max(round(_REACH_MM * px_per_mm / factor), 1)
    wide = reduced_patch(ours, view.px, (u + reach, v + reach), factor)
    patch = reduced_patch(theirs, place, (u, v), factor)
    if wide is None or patch is None or patch.std() < _LEAST_CONTRAST:
        return None
    return float(cv2.matchTemplate(wide, patch, cv2.TM_CCOEFF_NORMED).max())


class UnlistedParts(NamedTuple):
    """Corners on what should be the bare board."""

    bare: int
    raised: int
    sunk: int
    """Number of those that seem to lie below it: false links do both alike."""
    places: Floats
    """(n, 2) CAD coordinates of places where corners stand above the board."""

    @property
    def other_type(self) -> bool:
        """Whether parts stand where a board of this type has none."""
        enough = len(self.places) >= _LEAST_PLACES and self.raised > _LEAST_RAISED_SHARE * self.bare
        return enough and self.sunk <= _SUNK * self.raised


def find_unlisted_parts(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> UnlistedParts:
    """Find corners above the bare board, from links between rows away from components and from the outline."""
    o, motion, c = problem.links, adjusted.motion, adjusted.similarity
    # Without an outline of the board itself, what stands on a carrier or beside the board would count.
    unknown = plane.board_type.outline is None or bool(plane.board_type.fixture_marks)
    if unknown or problem.surface is None or c is None or not len(adjusted.surface_mm) or not len(o):
        return UnlistedParts(0, 0, 0, np.zeros((0, 2)))
    on_board = links_on_board(plane, c, o, motion, float(np.median(o.px_per_mm)))
    bare = (problem.component < 0) & ~problem.reaches_component & (o.p != o.q)
    at = on_board[bare[on_board]]
    height, sigma, aside, place, _ = adjusted.link_heights(at, _LEAST_FLOOR_PX)
    known = (sigma < _WORST_MM) & (aside < _ASIDE)
    limit = np.maximum(_HIGH_SIGMAS * sigma, _HIGH_MM)
    raised = known & (height > limit)
    squares = np.unique(np.floor(place[raised] / _PLACE_MM), axis=0)
    places = apply(np.linalg.inv(plane.matrix(c)), (squares + 0.5) * _PLACE_MM) if len(squares) else np.zeros((0, 2))
    return UnlistedParts(int(known.sum()), int(raised.sum()), int((known & (height < -limit)).sum()), places)


def unlisted_part_reasons(parts: UnlistedParts, plane: BoardPlane) -> list[Reason]:
    """Return a reason if parts stand where a board of this type has none."""
    if not parts.other_type:
        return []
    unit, digits = plane.board_type.unit, _DIGITS[plane.board_type.unit]
    where = ", ".join(f"({x:.{digits}f}, {y:.{digits}f})" for x, y in parts.places[:3].tolist())
    more = "" if len(parts.places) <= 3 else f" and {len(parts.places) - 3} more"
    text = (
        f"parts stand at about {len(parts.places)} places where board type {plane.board_type.name!r} has none ("
        f"{where}{more}, CAD coordinates in {unit}), and too few of its components are recognised at their "
        "places: the board is of another type; compare it with its order. If it is of this type, add the missing "
        "parts to the board type, or teach a reference"
    )
    return [Reason(ReasonCode.UNLISTED_PARTS, text)]

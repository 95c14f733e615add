"""Parts that stand on the board where the board type has none: they show a board of another type.

Fiducials and outline of two board types may be the same. Their parts are not: corners of a part that the board type
does not list move from row to row as points above the bare board do. A list without connectors causes the same, so
the parts are a reason only if too few components show their centres where C puts them.

Compare components with their pictures in the reference: a board of another type has other parts at these places.

Fiducials, outline and holes of two board types may be the same. The points of the reference that are found then agree
with the fiducials, but lie beside the components. If hardly any of them lies on a component, the picture of each
component is correlated with that of the reference. On a board of the same type some parts may be absent or have other
markings, but their pads look alike.
"""

from __future__ import annotations

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
_LEAST_CONTRAST = 4.0
"""Least standard deviation of the grey levels of a component in the reference."""
_ALIKE = 0.6
"""Least correlation of two pictures of a component that look alike."""
_LEAST_SHARE = 0.3
"""Least share of components that look alike on a board of the same type. Measured: hostile.md."""


class Likeness(NamedTuple):
    """How many components were compared with the reference, and how many of them look alike."""

    compared: int
    alike: int

    @property
    def other_type(self) -> bool:
        """Whether the components show that the board is of another type than the reference."""
        return self.compared >= _LEAST and self.alike < _LEAST_SHARE * self.compared


def shown_by_points(plane: BoardPlane, points: FiducialPoints | None, residual_px: Floats) -> bool:
    """Return whether points of the reference that fit lie on enough components that these need no comparison.

    Args:
        residual_px: (k, 2) their residuals in the adjustment.
    """
    if points is None:
        return False
    fitting = inliers(points, residual_px) & (points.which == REFERENCE)
    on = plane.components.find(np.eye(3), plane.cad(points.cad[fitting]))
    return len(set(on[on >= 0].tolist())) >= _LEAST_SHARE * len(plane.components.addresses)


def compare_components(plane: BoardPlane, views: list[PartView], scene: Scene, reference: ReferenceScene) -> Likeness:
    """Compare components in the frames of a run with the same components in the same frames of the reference.

    Args:
        reference: the reference, with its own views of the components.
    """
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
    """Return the correlation of two pictures of a component, at the distance at which it is highest.

    None if the whole component is not in both frames, or if the reference shows no contrast there.
    """
    half = view.half_px + _MARGIN_MM * px_per_mm
    factor = reduction(half, _MOST_NODES)
    nodes, reach = np.ceil(half / factor).astype(int), max(round(_REACH_MM * px_per_mm / factor), 1)
    wide, patch = reduced_patch(ours, view.px, nodes + reach, factor), reduced_patch(theirs, place, nodes, factor)
    if wide is None or patch is None or patch.std() < _LEAST_CONTRAST:
        return None
    return float(cv2.matchTemplate(wide, patch, cv2.TM_CCOEFF_NORMED).max())


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
_LEAST_PLACES, _LEAST_RAISED_SHARE, _SUNK = 3, 0.03, 1 / 3
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
        enough = len(self.places) >= _LEAST_PLACES and self.raised > _LEAST_RAISED_SHARE * self.bare
        return enough and self.sunk <= _SUNK * self.raised


def find_unlisted_parts(plane: BoardPlane, problem: Problem, adjusted: AdjustmentResult) -> UnlistedParts:
    """Find corners above the bare board, from links between rows away from components and from the outline.

    Args:
        problem: the problem of the adjustment, with placed components.
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

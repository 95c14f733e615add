"""Compare components with their pictures in the reference: a board of another type has other parts at these places.

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

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.board.reference_orientation import ReferenceScene
from vaoi_station.stitching.components.part_views import PartView, reduced_patch, reduction
from vaoi_station.stitching.matching.scene import Scene

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
        plane: plane of the board type.
        points: the k points with known CAD coordinates.
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
        plane: plane of the board type.
        views: one view of each component.
        scene: the cameras and frames of the run.
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

"""A reference run (section 3.3.3): stitched once, kept, and later runs of its board type are placed against it.

Frame (i, j) of a run shows nearly what frame (i, j) of the reference shows. Points linked between the two have
known CAD coordinates, since the reference was stitched; so each is an observation like a fiducial's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Stitch
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.evidence import FrameKey, Links, Task

_SCATTER_PX = 0.03
"""Of single links beyond image noise."""
_SHARED_PX = 0.006
"""What the links of one frame share and does not average out."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A stitched run of the board type, and which of its frames are good."""

    stitch: Stitch
    """Its CAD mapping and row motion are what is used; the rest may have been left out."""
    present: frozenset[FrameKey]
    name: str = ""
    """What results call it."""

    def task(self, key: FrameKey) -> Task | None:
        """The link of a frame of the run to the reference; None where that has no such frame."""
        return Task("reference", key, key) if key in self.present else None


def cad_points(
    links: Sequence[Links], cameras: Sequence[Camera], plane: BoardPlane, reference: Reference
) -> FiducialPoints:
    """Linked points as observations: seen in a row of the run, known in CAD through the reference."""
    rows, ground, lean, cad, sigma, resolution = [], [], [], [], [], []
    c = reference.stitch.cad_matrix
    assert c is not None
    for e in links:
        if not len(e.a_px) or e.task.b is None:
            continue
        camera, row = cameras[e.task.a[0]], e.task.a[1]
        here = camera.ground(e.a_px)
        there = apply(np.linalg.inv(reference.stitch.row_motion[e.task.b[1]]), camera.ground(e.b_px))
        px = np.sqrt(np.maximum(np.trace(np.linalg.inv(e.information), axis1=1, axis2=2) / 2, 0))
        single = np.hypot(px, _SCATTER_PX) * np.sqrt(1 + len(px) * (_SHARED_PX / _SCATTER_PX) ** 2)
        rows.append(np.full(len(here), row))
        ground.append(here)
        lean.append(camera.parallax(here))
        cad.append(plane.flat(apply(np.linalg.inv(c), there)))
        sigma.append(single / camera.px_per_mm)
        resolution.append(np.full(len(here), camera.px_per_mm))
    if not rows:
        return FiducialPoints.empty()
    return FiducialPoints(
        np.concatenate(rows),
        np.concatenate(ground),
        np.concatenate(lean),
        np.concatenate(cad),
        np.concatenate(sigma),
        np.concatenate(resolution),
        np.full(sum(map(len, rows)), REFERENCE),
    )


def initial_similarity(plane: BoardPlane, reference: Reference, points: FiducialPoints, motion: Motion) -> Floats:
    """C to start from: the reference's, shifted to where the run's points are by the belt's nominal motion."""
    c = reference.stitch.cad_matrix
    assert c is not None
    start = np.array([c[0, 0], c[1, 0], c[0, 2], c[1, 2]])
    board = motion.board(points.row, points.ground_mm)
    off = np.median(board - apply(plane.matrix(start), plane.cad(points.cad)), axis=0)
    return np.concatenate([start[:2], start[2:] + off])

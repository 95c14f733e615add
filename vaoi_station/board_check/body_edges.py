"""The edges of all bodies of a board type, as points with normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import Ints
from vaoi_station.stitching.geometry import ComponentIndex

_STEP_MM = 0.25
_LEAST, _MOST = 3, 40
"""Least and largest number of points on one edge."""


@dataclass(frozen=True, eq=False)
class BodyEdges:
    """k points on the edges of bodies, in mm: CAD coordinates times the size of their unit."""

    points: Floats
    """(k, 2)."""
    normals: Floats
    """(k, 2) unit vectors across the edge."""
    part: Ints
    """(k,) number of the component in the board type, ascending."""
    weight: Floats
    """(k,) each component counts by the root of its perimeter."""

    @staticmethod
    def of(board_type: BoardType) -> BodyEdges:
        """Return the points of all components of a board type."""
        corners = ComponentIndex.of(board_type).corners * board_type.mm_per_unit
        sides = np.roll(corners, -1, axis=1) - corners
        lengths = np.hypot(sides[..., 0], sides[..., 1])
        counts = np.clip(np.ceil(lengths / _STEP_MM), _LEAST, _MOST).astype(np.int_)
        side = np.repeat(np.arange(counts.size), counts.ravel())
        starts = np.cumsum(counts.ravel()) - counts.ravel()
        share = (np.arange(len(side)) - starts[side] + 0.5) / counts.ravel()[side]
        along = sides.reshape(-1, 2)[side]
        normals = np.stack([along[:, 1], -along[:, 0]], 1) / lengths.ravel()[side, None]
        part, perimeter = side // 4, lengths.sum(1)
        # Points of an edge share its length, so that a long edge of few points counts as much.
        weight = lengths.ravel()[side] / counts.ravel()[side] / np.sqrt(perimeter[part])
        return BodyEdges(corners.reshape(-1, 2)[side] + share[:, None] * along, normals, part, weight)

    def of_parts(self, parts: Ints) -> BodyEdges:
        """Return the points of some components only."""
        keep = np.isin(self.part, parts)
        return BodyEdges(self.points[keep], self.normals[keep], self.part[keep], self.weight[keep])

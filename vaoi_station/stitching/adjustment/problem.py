"""The input of an adjustment and its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints, Observations

FIXTURE, REFERENCE = -1, -2
"""Values of `FiducialPoints.which` for points that are no fiducial of the board."""


@dataclass(frozen=True, eq=False)
class FiducialPoints:
    """k points with CAD coordinates, observed in rows: fiducials, fixture marks, points of a reference run."""

    row: Ints
    """(k,)"""
    ground_mm: Floats
    """(k, 2) point on the ground plane."""
    lean: Floats
    """(k, 2) displacement in mm per mm of height."""
    cad: Floats
    """(k, 2) CAD coordinates, y already flipped where the mapping mirrors."""
    sigma_mm: Floats
    """(k,) standard deviation of the point."""
    px_per_mm: Floats
    """(k,) local resolution."""
    which: Ints
    """(k,) index of the board's fiducial; negative for points of which there are many: `FIXTURE`, `REFERENCE`."""

    @staticmethod
    def joined(parts: Sequence[FiducialPoints]) -> FiducialPoints:
        """Concatenate several sets of points."""
        names = ("row", "ground_mm", "lean", "cad", "sigma_mm", "px_per_mm", "which")
        return FiducialPoints(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    @staticmethod
    def empty() -> FiducialPoints:
        """Return a set without points."""
        pairs, no = np.zeros((0, 2)), np.zeros(0, dtype=np.int_)
        return FiducialPoints(no, pairs, pairs, pairs, np.zeros(0), np.zeros(0), no)


@dataclass(frozen=True, eq=False)
class SurfaceBasis:
    """Basis functions of the board's height: values per link and detection, and priors."""

    at_links: Floats
    """(k, f)."""
    at_fiducials: Floats
    """(s, f)."""
    sigma_mm: Floats
    """(f,) prior standard deviation of each coefficient."""


@dataclass(frozen=True, eq=False)
class Problem:
    """All observations and priors of an adjustment."""

    times_s: Floats
    """(m,) time of each row's pulse."""
    velocity_mm_s: Floats
    """(2,) nominal velocity of the conveyor."""
    links: Observations
    component: Ints
    """(k,) index of the component a link lies on, −1 for the bare board."""
    fiducials: FiducialPoints | None = None
    nominal_scale: float = 1.0
    """mm per CAD unit."""
    surface: SurfaceBasis | None = None
    """None: the board is taken to lie in the calibrated plane."""


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """The solution, its covariance and its residuals."""

    motion: Motion
    similarity: Floats | None
    """(4,) a, b, x, y: board = [a −b; b a]·cad + (x, y)."""
    surface_mm: Floats
    """(f,) coefficients of the surface."""
    heights_mm: Floats
    """(2, number of components) estimated from links from row to row, and from links between cameras; NaN with too few
    links, or where the part is so tall that its links are outliers."""
    covariance: Floats
    """(m, u, u) of each row's (φ, sx, sy) together with C and the surface; entries of row 0, which is held, are 0."""
    link_sigma: Floats
    """(k,) residual of each link in standard deviations."""
    link_px: Floats
    """(k, 2) residual of each link in px, along the tester's axes."""
    weight: Floats
    """(k,) final robust weight; 0: not used."""
    fiducial_px: Floats
    """(s, 2) residuals of the detections in px."""
    floor_px: float
    """Noise floor of links from row to row."""
    sigma0: float
    """Square root of the reduced χ² of the links."""

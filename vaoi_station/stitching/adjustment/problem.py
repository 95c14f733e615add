"""What an adjustment is given and what comes out of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints, Observations

FIXTURE, REFERENCE = -1, -2
"""Instead of the number of a fiducial."""


@dataclass(frozen=True, eq=False)
class FiducialPoints:
    """Points known in CAD and seen in rows: fiducials, marks of the fixture, points of a reference run."""

    row: Ints
    ground_mm: Floats
    lean: Floats
    cad: Floats
    """(k, 2) CAD coordinates, y already flipped where the mapping mirrors."""
    sigma_mm: Floats
    px_per_mm: Floats
    which: Ints
    """(k,) number of the board's fiducial; negative for points of which there are many: `FIXTURE`, `REFERENCE`."""

    @staticmethod
    def joined(parts: Sequence[FiducialPoints]) -> FiducialPoints:
        """All points of several sets."""
        names = ("row", "ground_mm", "lean", "cad", "sigma_mm", "px_per_mm", "which")
        return FiducialPoints(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    @staticmethod
    def empty() -> FiducialPoints:
        """No points."""
        pairs, no = np.zeros((0, 2)), np.zeros(0, dtype=np.int_)
        return FiducialPoints(no, pairs, pairs, pairs, np.zeros(0), np.zeros(0), no)


@dataclass(frozen=True, eq=False)
class SurfaceBasis:
    """Basis functions of the board's height: values per link and sighting, prior sigmas in mm."""

    at_links: Floats
    """(k, f)."""
    at_fiducials: Floats
    sigma_mm: Floats


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that is observed or known beforehand."""

    times_s: Floats
    velocity_mm_s: Floats
    links: Observations
    component: Ints
    """(k,) number of the component a link lies on, −1 for the bare board."""
    fiducials: FiducialPoints | None = None
    nominal_scale: float = 1.0
    surface: SurfaceBasis | None = None


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """The solution and how far it can be trusted."""

    motion: Motion
    similarity: Floats | None
    """(4,) a, b, x, y: board = [a −b; b a]·cad + (x, y)."""
    surface_mm: Floats
    heights_mm: Floats
    """(2, number of components): as links from row to row have it, and as those between cameras have it; NaN where too
    few tell, or where the part is so tall that its links were left out."""
    covariance: Floats
    """(m, u, u) of each row's (φ, sx, sy) together with C and the surface; those of row 0, which is held, are 0."""
    link_sigma: Floats
    """(k,) residual of each link in standard deviations."""
    link_px: Floats
    """(k, 2) residual of each link in px, along the tester's axes."""
    weight: Floats
    """(k,) final robust weight; 0: not used."""
    fiducial_px: Floats
    """(s, 2) residuals of the sightings in px."""
    floor_px: float
    sigma0: float
    """Square root of the reduced χ² of the links."""

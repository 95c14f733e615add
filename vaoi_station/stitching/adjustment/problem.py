"""Data classes for the input of an adjustment and for its solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints, Observations

FIXTURE, REFERENCE = -1, -2
"""Values of `FiducialPoints.which` for fixture marks and for points of a reference run."""


@dataclass(frozen=True, eq=False)
class FiducialPoints:
    """k observed points of known CAD coordinates: detections of fiducials and fixture marks, points of a reference."""

    row: Ints
    """(k,) row in which each point was seen."""
    ground_mm: Floats
    """(k, 2) observed point on the ground plane."""
    lean: Floats
    """(k, 2) displacement of each ground point, mm, per mm of height."""
    cad: Floats
    """(k, 2) CAD coordinates; y is already flipped if the CAD mapping mirrors."""
    sigma_mm: Floats
    """(k,) standard deviation of the observed point, per axis."""
    px_per_mm: Floats
    """(k,) resolution of the frame at each point."""
    which: Ints
    """(k,) index of the fiducial of the board type; `FIXTURE` or `REFERENCE`, both negative, for other points."""
    camera: Ints
    """(k,) camera that saw each point."""

    @staticmethod
    def joined(parts: Sequence[FiducialPoints]) -> FiducialPoints:
        """Concatenate several sets of observed points to one."""
        return FiducialPoints(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(FiducialPoints)))

    def select(self, at: Ints) -> FiducialPoints:
        """Return the points of these indices only."""
        return FiducialPoints(*(getattr(self, f.name)[at] for f in fields(self)))

    @property
    def fixture_marks(self) -> int:
        """Number of fixture marks among the points, each counted once."""
        return len(np.unique(self.cad[self.which == FIXTURE], axis=0))

    def place(self, rows: Ints) -> bool:
        """Return whether at least two different points in these rows place the board there, without any links."""
        return len(np.unique(self.cad[np.isin(self.row, rows)], axis=0)) >= 2

    @staticmethod
    def empty() -> FiducialPoints:
        """Return a set of observed points without any point."""
        pairs, no = np.zeros((0, 2)), np.zeros(0, dtype=np.int_)
        return FiducialPoints(no, pairs, pairs, pairs, np.zeros(0), np.zeros(0), no, no)


@dataclass(frozen=True, eq=False)
class SurfaceBasis:
    """The f basis functions of the surface: their values at links and detections, and the priors of coefficients."""

    at_links: Floats
    """(k, f) values of the basis functions at the k links."""
    at_fiducials: Floats
    """(s, f) values of the basis functions at the s points of `Problem.fiducials`."""
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
    """(k,) index of the component on which each link lies, −1 for the bare board."""
    fiducials: FiducialPoints | None = None
    nominal_scale: float = 1.0
    """Nominal scale of C, mm per CAD unit."""
    surface: SurfaceBasis | None = None
    """The surface to estimate; None if the board is assumed to lie in the calibrated plane."""
    near: Ints = field(default_factory=lambda: np.zeros(0, np.int_))
    """(k,) number of the component that the patch of each link may reach, −1 for none; empty if the components are not
    placed."""
    cameras: tuple[Camera, ...] = ()
    """The cameras whose displacements are estimated; none if the calibration is taken as exact."""
    light: Ints = field(default_factory=lambda: np.zeros(0, np.int_))
    """(m,) number of the light of each row; empty if all rows have one light."""

    def select(self, at: Ints) -> Problem:
        """Return the problem with the links of these indices only, for a problem whose components are not placed."""
        return replace(self, links=self.links.select(at), component=self.component[at])

    @property
    def reaches_component(self) -> NDArray[np.bool_]:
        """(k,) whether the patch of each link may reach a component."""
        return self.near >= 0 if len(self.near) else np.zeros(len(self.links), np.bool_)

    @property
    def of_two_lights(self) -> NDArray[np.bool_]:
        """(k,) whether each link joins two rows of different lights."""
        if not len(self.light):
            return np.zeros(len(self.links), np.bool_)
        return np.asarray(self.light[self.links.p] != self.light[self.links.q])


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """The displacements of n cameras against their calibration, as one run shows them."""

    displacement_px: Floats
    """(n, 3) estimated x, y and turn of each camera, px."""
    covariance: Floats
    """(3n, 3n) covariance of the estimated displacements, px²."""
    cross: Floats
    """(m, u, 3n) covariance of the displacements with the u unknowns of `AdjustmentResult.covariance`, by row."""
    information: Floats
    """(3n, 3n) px⁻², information matrix of the displacements by the run alone, without any prior on them.

    It contains no information about a motion of the whole array, because pictures of a board do not show one."""
    vector: Floats
    """(3n,) px⁻¹, the product of `information` and the displacements that fit the run best without any prior."""
    rivals: tuple[int, ...] = ()
    """Cameras that may have moved instead of those with a displacement."""

    def alone(self, camera: int) -> Floats:
        """Return the displacements (n, 3) px that fit the run best if only this camera has moved."""
        displacement_px = np.zeros_like(self.displacement_px)
        own = slice(PARAMETERS * camera, PARAMETERS * (camera + 1))
        displacement_px[camera] = np.linalg.lstsq(self.information[own, own], self.vector[own], rcond=None)[0]
        return displacement_px

    def fit(self, displacement_px: Floats) -> float:
        """Return by how much displacements (n, 3) px reduce χ² of the run, without any prior on them."""
        d = displacement_px.ravel()
        return float(2 * d @ self.vector - d @ self.information @ d)


@dataclass(frozen=True, eq=False)
class Influence:
    """How the solution changes without c groups of observations, each left out by itself (`influence.py`)."""

    change: Floats
    """(c, m, u) for each group and row, change of the u unknowns of `AdjustmentResult.covariance`."""
    growth: Floats
    """(c, m, u, u) by how much their covariance grows: the covariance of the change, if the noise model is right."""
    grids: NDArray[np.bool_]
    """(c, 4) the grids in which each group of links is a cluster; none for a group of points of `Problem.fiducials`."""
    marks: int
    """Number of marks that were left out in turn, with those without which little changes."""

    @property
    def of_marks(self) -> NDArray[np.bool_]:
        """(c,) whether each group is of points of `Problem.fiducials`."""
        return np.logical_not(self.grids.any(1))

    def select(self, at: NDArray[np.bool_]) -> Influence:
        """Return the influence of these groups only."""
        return Influence(self.change[at], self.growth[at], self.grids[at], self.marks)


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """The solution of an adjustment with its covariance and its residuals."""

    motion: Motion
    similarity: Floats | None
    """(4,) C as (a, b, x, y): board = [a −b; b a]·cad + (x, y). None if the problem has no fiducials."""
    surface_mm: Floats
    """(f,) coefficients of the surface, mm."""
    heights_mm: Floats
    """(2, number of components) component heights: first from links between rows, second from links between cameras.
    NaN if a component has too few links, or if it is so tall that its links are outliers."""
    covariance: Floats
    """(m, u, u) for each row, the covariance of its (φ, sx, sy) together with C and the surface. Row 0 is fixed by the
    gauge: the entries of its (φ, sx, sy) are 0."""
    link_sigma: Floats
    """(k,) residual of each link in standard deviations."""
    link_px: Floats
    """(k, 2) residual of each link in px, along the axes of tester coordinates."""
    weight: Floats
    """(k,) final robust weight of each link, 0 … 1; a link of weight 0 has no influence."""
    fiducial_px: Floats
    """(s, 2) residuals of the points of `Problem.fiducials` in px."""
    floor_px: float
    """Noise floor of the links between rows."""
    sigma0: float
    """Square root of the reduced χ² of the links: 1 if their residuals are as large as their noise model states."""
    problem: Problem
    """The problem, with the displacements of the cameras applied to its links, points and cameras."""
    cameras: CameraEstimate | None = None
    """The displacements of the cameras; None if the calibration was taken as exact."""
    influence: Influence | None = None
    """The influence of the links of single places and of single marks; None if it is small, or was not examined."""

"""The displacements of the cameras as the adjustment of a run estimated them, with residuals per camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import comparable_cameras, ground_changes, move_points
from vaoi_station.stitching.adjustment.problem import SIGMA_MM, AdjustmentResult, FiducialPoints, Ints, SurfaceBasis
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.quality.findings import Findings

_USED = 0.1
"""Robust weight above which a link counts as used."""


@dataclass(frozen=True, eq=False)
class DisplacementEstimate:
    """The displacements d̂ of n cameras estimated from one run, in the form of normal equations.

    A displacement d fits the run worse, the larger (d − d̂)ᵀ·information·(d − d̂) is.
    """

    information: Floats
    """(3n, 3n) px⁻², information matrix of d̂. It contains no information about a motion of the whole array."""
    vector: Floats
    """(3n,) px⁻¹, the product information · d̂. It is finite even where the run does not determine d̂."""
    rms_px: Floats
    """(n,) rms residual of links to neighbouring cameras and fiducials, with the calibrated cameras; NaN if none
    exist."""
    left_px: Floats
    """(n,) rms of the same residuals after the estimated displacements are applied."""
    links: Ints
    """(n,) number of links to neighbouring cameras that were used."""
    fiducials: Ints
    """(n,) number of fiducial detections that were used."""


def estimate_displacements(findings: Findings) -> DisplacementEstimate:
    """Return the displacements that the adjustment of a run estimated, with counts and residuals per camera."""
    adjusted, n = _with_displacements(findings), len(findings.scene.cameras)
    if adjusted.cameras is None:
        # A single camera, or a run without links, gives no evidence of displacements.
        none, nothing = np.full(n, np.nan), np.zeros(n, dtype=np.int_)
        size = PARAMETERS * n
        return DisplacementEstimate(np.zeros((size, size)), np.zeros(size), none, none, nothing, nothing)
    o, points = adjusted.problem.links, adjusted.problem.fiducials
    # Links on components are left out, because the height of a component looks like a displacement of a camera.
    kept = np.flatnonzero((o.p == o.q) & (adjusted.weight > _USED) & (findings.problem.component < 0))
    a, b = o.camera_a[kept], o.camera_b[kept]
    counted = _of_c(findings, points)
    seen_by = points.camera[counted] if points is not None else np.zeros(0, dtype=np.int_)
    marks = np.bincount(seen_by, minlength=n)
    links = np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    left = adjusted.link_px[kept], adjusted.fiducial_px[counted]
    before = left[0] + _explained(findings, adjusted, kept), left[1] + _explained_detections(findings, adjusted)

    def rms(residuals: tuple[Floats, Floats]) -> Floats:
        of_links, of_marks = ((r**2).sum(1) for r in residuals)
        total = np.bincount(a, of_links, minlength=n) + np.bincount(b, of_links, minlength=n)
        total = total + np.bincount(seen_by, of_marks, minlength=n)
        count = links + marks
        return np.asarray(np.sqrt(np.divide(total, count, out=np.full(n, np.nan), where=count > 0)))

    information = adjusted.cameras.information
    return DisplacementEstimate(information, adjusted.cameras.vector, rms(before), rms(left), links, marks)


def _of_c(findings: Findings, points: FiducialPoints | None) -> Ints:
    """Return the indices of the detections of fiducials that determine C: others lie beside their places by C."""
    if points is None:
        return np.zeros(0, dtype=np.int_)
    found = set(points.which[points.which >= 0].tolist())
    plane, marks = findings.plane, points.fixture_marks
    apart = plane.board_type.apart_from_c(found, marks) if plane is not None else frozenset()
    return np.flatnonzero((points.which >= 0) & ~np.isin(points.which, sorted(apart)))


def _with_displacements(findings: Findings) -> AdjustmentResult:
    """Return the adjustment of a run with the displacements of its cameras.

    Without a CAD mapping, the adjustment assumed exact cameras and a board in the calibrated plane. Its links are then
    adjusted once more, for a plane board at an unknown height.
    """
    adjusted, cameras = findings.adjusted, comparable_cameras(findings.calibrated)
    if findings.mapping is not None or not findings.method.links or not cameras:
        return adjusted
    problem = replace(adjusted.problem, cameras=cameras)
    if all(camera.working_distance_mm is not None for camera in cameras):
        height = SurfaceBasis(np.ones((len(problem.links), 1)), np.ones((0, 1)), SIGMA_MM[:1])
        problem = replace(problem, surface=height)
    return adjust(problem, adjusted.motion)


def _calibrated(findings: Findings, adjusted: AdjustmentResult, ground_mm: Floats, camera: Ints) -> Floats:
    """Return ground points (k, 2) of displaced cameras as the calibrated cameras would see them."""
    estimate = adjusted.cameras
    assert estimate is not None
    changes = ground_changes(findings.calibrated, estimate.displacement_px)
    return move_points(np.ascontiguousarray(ground_mm), camera, np.ascontiguousarray(np.linalg.inv(changes)))


def _explained(findings: Findings, adjusted: AdjustmentResult, kept: Ints) -> Floats:
    """Return the part (k, 2) px of the links' residuals that the displacements explain."""
    o, motion = adjusted.problem.links, adjusted.motion
    a_mm = _calibrated(findings, adjusted, o.a_mm[kept], o.camera_a[kept])
    b_mm = _calibrated(findings, adjusted, o.b_mm[kept], o.camera_b[kept])
    change = motion.turned(o.q[kept], b_mm - o.b_mm[kept]) - motion.turned(o.p[kept], a_mm - o.a_mm[kept])
    return np.asarray(change * o.px_per_mm[kept, None])


def _explained_detections(findings: Findings, adjusted: AdjustmentResult) -> Floats:
    """Return the part (s, 2) px of the residuals of the fiducials' detections that the displacements explain."""
    points = adjusted.problem.fiducials
    if points is None:
        return np.zeros((0, 2))
    at = _of_c(findings, points)
    before = _calibrated(findings, adjusted, points.ground_mm[at], points.camera[at])
    change = adjusted.motion.turned(points.row[at], before - points.ground_mm[at])
    return np.asarray(change * points.px_per_mm[at, None])

"""The displacements of the cameras as the adjustment of a run estimated them, with residuals per camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.displacement import PARAMETERS, CameraMatrices, move_points
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import comparable_cameras
from vaoi_station.stitching.adjustment.problem import SIGMA_MM, AdjustmentResult, Ints, SurfaceBasis
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
    """(n,) rms residual of links to neighbouring cameras and fiducials, with calibrated cameras; NaN without any."""
    left_px: Floats
    """(n,) rms of the same residuals after the estimated displacements are applied."""
    links: Ints
    """(n,) number of links to neighbouring cameras that were used."""
    fiducials: Ints
    """(n,) number of fiducial detections that were used."""


def estimate_displacements(findings: Findings) -> DisplacementEstimate:
    """Return the displacements that the adjustment of a run estimated, with counts and residuals per camera."""
    adjusted, n = _with_displacements(findings), len(findings.scene.cameras)
    estimate = adjusted.cameras
    if estimate is None:
        # A single camera, or a run without links, gives no evidence of displacements.
        none, nothing, size = np.full(n, np.nan), np.zeros(n, dtype=np.int_), PARAMETERS * n
        return DisplacementEstimate(np.zeros((size, size)), np.zeros(size), none, none, nothing, nothing)
    changes = CameraMatrices.of(findings.calibrated).ground_changes(estimate.displacement_px)
    back = np.asarray(np.linalg.inv(changes), dtype=np.float64)

    def explained(ground_mm: Floats, camera: Ints, row: Ints) -> Floats:
        """Return by what (k, 2) mm of the board points lie elsewhere as the calibrated cameras would see them."""
        change = move_points(ground_mm, camera, back) - ground_mm
        return np.asarray(adjusted.motion.turned(row, change))

    # Links on components are left out, because the height of a component looks like a displacement of a camera.
    o, points = adjusted.problem.links, adjusted.problem.fiducials
    kept = np.flatnonzero((o.p == o.q) & (adjusted.weight > _USED) & (findings.problem.component < 0))
    a, b = o.camera_a[kept], o.camera_b[kept]
    link_px = adjusted.link_px[kept]
    change = explained(o.b_mm[kept], b, o.q[kept]) - explained(o.a_mm[kept], a, o.p[kept])
    calibrated_link_px = link_px + change * o.px_per_mm[kept, None]
    seen_by, mark_px, calibrated_mark_px = np.zeros(0, dtype=np.int_), np.zeros((0, 2)), np.zeros((0, 2))
    if points is not None:
        # Only detections of fiducials that determine C: others lie beside their places by C.
        found, plane = set(points.which[points.which >= 0].tolist()), findings.plane
        apart = plane.board_type.apart_from_c(found, points.fixture_marks) if plane is not None else frozenset()
        at = np.flatnonzero((points.which >= 0) & ~np.isin(points.which, sorted(apart)))
        seen_by, mark_px = points.camera[at], adjusted.fiducial_px[at]
        change = explained(points.ground_mm[at], seen_by, points.row[at])
        calibrated_mark_px = mark_px + change * points.px_per_mm[at, None]
    marks = np.bincount(seen_by, minlength=n)
    links = np.bincount(a, minlength=n) + np.bincount(b, minlength=n)

    def rms(of_links: Floats, of_marks: Floats) -> Floats:
        squares = np.concatenate([(of_links**2).sum(1)] * 2 + [(of_marks**2).sum(1)])
        total, count = np.bincount(np.concatenate([a, b, seen_by]), squares, minlength=n), links + marks
        return np.asarray(np.sqrt(np.divide(total, count, out=np.full(n, np.nan), where=count > 0)))

    before, left = rms(calibrated_link_px, calibrated_mark_px), rms(link_px, mark_px)
    return DisplacementEstimate(estimate.information, estimate.vector, before, left, links, marks)


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

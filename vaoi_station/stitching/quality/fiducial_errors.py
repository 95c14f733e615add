"""An error of one of three or more fiducials, as the others show it.

Fiducials that lie where the CAD data have them fit together to a few hundredths of a pixel. If they do not, one of them
may be off by far more than its residual: bow, tilt and scale of the board, and the others, take a part of the error,
and the residual may be that of another fiducial. So each of them is left out in turn, and its distance from the place
that the rest predicts is the error that would explain everything.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.fiducial_equations import detection_sigma_mm, fiducial_residuals
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.board.board_plane import BoardPlane

_LEAST = 3
"""Least number of fiducials that contradict one another: two leave no residual."""
_CONTRADICTION = 4.0
"""Residual of a fiducial above which the fiducials do not fit together, in standard deviations. Measured: right boards
reach 2.3 (hostile.md)."""
_LIMIT_PX = 0.30
"""Largest error of one fiducial that is accepted, px: that of a residual, and of one of two fiducials."""


def contradiction_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints | None, px_per_mm: float
) -> list[Reason]:
    """Return a reason if fiducials do not fit together, and an error of one of them that would explain it is too large.

    Args:
        plane: plane of the board type.
        adjusted: solution of the common adjustment of all unknowns.
        points: fiducial points of that adjustment.
        px_per_mm: resolution of the station.
    """
    if points is None or adjusted.similarity is None or (points.which < 0).any():
        return []
    found = set(points.which.tolist())
    used = sorted(found - plane.board_type.apart_from_c(found))
    if len(used) < _LEAST:
        return []
    off = _residuals(points, adjusted.fiducial_px, used)
    worst = max(off, key=lambda n: off[n][1])
    if off[worst][1] <= _CONTRADICTION:
        return []
    errors = _errors_mm(adjusted, used)
    if max(errors.values(), default=0.0) * px_per_mm <= _LIMIT_PX:
        return []
    names = [fiducial.name for fiducial in plane.board_type.fiducials]
    px, sigmas = off[worst]
    each = ", or ".join(f"{names[n]} by {mm:.2f} mm ({mm * px_per_mm:.1f} px)" for n, mm in errors.items())
    text = (
        f"the fiducials do not fit together: {names[worst]} lies {px:.2f} px from its place, {sigmas:.0f} standard "
        f"deviations; one that is not at its CAD position would explain it, {each} (limit {_LIMIT_PX} px); check them "
        "in the CAD data and on the board"
    )
    return [Reason(ReasonCode.FIDUCIAL_OFF_PLACE, text)]


def _residuals(points: FiducialPoints, off_px: Floats, used: Collection[int]) -> dict[int, tuple[float, float]]:
    """Return the length of the mean residual of each fiducial, px, and in its standard deviations per axis."""
    weight = (detection_sigma_mm(points) * points.px_per_mm) ** -2.0
    out = {}
    for n in used:
        own = points.which == n
        px = float(np.hypot(*np.average(off_px[own], axis=0, weights=weight[own])))
        out[n] = px, px * float(np.sqrt(weight[own].sum()))
    return out


def _errors_mm(adjusted: AdjustmentResult, used: Collection[int]) -> dict[int, float]:
    """Return by how much each fiducial would be off its CAD position if it were the wrong one, mm.

    Those without which the others still do not fit are left out, unless that holds for all.
    """
    every = {n: _without(adjusted, n, [k for k in used if k != n]) for n in used}
    explained = {n: mm for n, (mm, sigmas) in every.items() if sigmas <= _CONTRADICTION}
    return explained or {n: mm for n, (mm, _) in every.items()}


def _without(adjusted: AdjustmentResult, n: int, others: Collection[int]) -> tuple[float, float]:
    """Adjust the run without fiducial n; return its distance (mm) from its place, and the others' largest residual.

    The cameras stay where the adjustment has found them. The residual is in standard deviations.
    """
    problem, points, c = adjusted.problem, adjusted.problem.fiducials, adjusted.similarity
    assert points is not None
    assert c is not None
    own = np.flatnonzero(points.which == n)
    rest, surface = np.flatnonzero(points.which != n), problem.surface
    basis = surface.at_fiducials if surface else np.zeros((len(points.which), 0))
    kept = surface and replace(surface, at_fiducials=basis[rest])
    fitted = adjust(replace(problem, fiducials=points.select(rest), surface=kept, cameras=()), adjusted.motion, c)
    assert fitted.similarity is not None
    alone = points.select(own)
    off_mm = fiducial_residuals(alone, fitted.motion, fitted.similarity, basis[own], fitted.surface_mm)[0]
    misfits = _residuals(points.select(rest), fitted.fiducial_px, others)
    return float(np.hypot(*off_mm.mean(0))), max(sigmas for _, sigmas in misfits.values())

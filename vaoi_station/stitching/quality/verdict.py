"""The verdict on a stitch, and the numbers it rests on.

ok: every position is good to a third of a pixel by its own standard deviation, and nothing contradicts
the model. degraded: usable, with the reason. failed: component positions cannot be given.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status
from vaoi_station.stitching.adjustment.motion import measured_velocity
from vaoi_station.stitching.adjustment.problem import FIXTURE, REFERENCE
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping
from vaoi_station.stitching.board.fiducial_assignment import outside_share
from vaoi_station.stitching.quality.absent_cameras import absent_camera_reasons
from vaoi_station.stitching.quality.agreement import fiducial_reasons, outline_reasons, uncertain_detections
from vaoi_station.stitching.quality.covariances import matrix_sigmas, row_covariances
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.uncertainty import surface_sigma_mm

_OK_SIGMA_PX = 0.20
_SEAM_LIMIT_PX = 0.30
_FLOOR_LIMIT_PX = 0.30
_OUTSIDE_LIMIT = 0.03
_OUTLIER = 8.5
"""Points further off, in their standard deviations, have no weight (6 per axis)."""


def decide_verdict(f: Findings) -> tuple[Status, tuple[str, ...]]:
    """Status and the reasons, in words and numbers; those of a failure begin with its cause."""
    if not f.scene.present:
        return Status.FAILED, ("no whole frame of any camera arrived: there is nothing to stitch",)
    if isinstance(f.found, Failure):
        absent = absent_camera_reasons(f.scene, f.plane if f.method.marks else None, f.expectation, f.moved.motion)
        return Status.FAILED, (*absent, f.found.reason, *_complaints(f))
    complaints = _complaints(f)
    return (Status.DEGRADED if complaints else Status.OK), tuple(complaints)


def _complaints(f: Findings) -> list[str]:
    out = []
    if f.method.links and not any(len(e.a_px) for e in f.links):
        out.append("no texture was found in any frame: is there a board?")
    if len(f.tied) > 1:
        parts = ", ".join(f"{g.min()}–{g.max()}" for g in f.tied)
        out.append(f"nothing ties rows {parts} to one another: their distance is the belt's nominal one")
    if f.adjusted.floor_px > _FLOOR_LIMIT_PX:
        out.append(
            f"links scatter by {f.adjusted.floor_px:.2f} px (limit {_FLOOR_LIMIT_PX}): the board is not rigid or flat"
        )
    for (i, j), px in f.seams_px.items():
        if px > _SEAM_LIMIT_PX:
            out.append(
                f"cameras {i} and {j} disagree by {px:.2f} px (limit {_SEAM_LIMIT_PX}): "
                "a camera has moved, or the board is bent more than a board may"
            )
    for (i, j), rows in f.strangers.items():
        out.append(
            f"cameras {i} and {j} show different things where they should overlap (in {rows} rows): a camera has moved"
        )
    if f.plane is not None and f.mapping is not None and f.adjusted.similarity is not None:
        out += _cad_complaints(f, f.plane, f.mapping, f.adjusted.similarity)
    return out


def _cad_complaints(f: Findings, plane: BoardPlane, mapping: CadMapping, c: Floats) -> list[str]:
    out = []
    board_type = plane.board_type
    points = mapping.problem.fiducials
    which = points.which if points is not None else np.zeros(0, dtype=np.int_)
    seen = {int(w) for w in which if w >= 0}
    if not f.method.marks:
        seen = set(range(len(board_type.fiducials)))
    for n, fiducial in enumerate(board_type.fiducials):
        if n not in seen and len(seen) < 2 and not (which < 0).any():
            out.append(f"fiducial {fiducial.name} was not found; one alone does not fix the board")
    resolution = float(np.mean([camera.px_per_mm for camera in f.scene.cameras]))
    out += fiducial_reasons(plane, f.adjusted, points, f.moved.motion, resolution) + outline_reasons(
        mapping.shift, resolution
    )
    if mapping.ambiguous:
        out.append(
            "turned by 180° the board would fit its fiducials as well, and neither outline nor parts tell: "
            "it is taken to lie as expected (a third fiducial off the symmetry would settle it)"
        )
    if mapping.outline is not None and not mapping.outline.visible:
        out.append(
            f"there is no edge where the board's outline should be (contrast {mapping.outline.contrast:.1f} "
            f"grey levels over {mapping.outline.pieces} places): it is another type, or lies elsewhere"
        )
    o = f.problem.links
    use = (f.adjusted.weight > 0.5) & (o.p != o.q)
    off_board = outside_share(plane, c, f.adjusted.motion.board(o.p[use], o.a_mm[use]))
    if off_board > _OUTSIDE_LIMIT:
        out.append(
            f"{off_board:.0%} of the texture lies off the board (limit {_OUTSIDE_LIMIT:.0%}): another type, or turned?"
        )
    worst = f.sigma.worst_px
    if worst is not None and worst > _OK_SIGMA_PX:
        blamed = uncertain_detections(plane, points, _OK_SIGMA_PX)
        out.append(f"positions are uncertain by {worst:.2f} px (1 σ, limit {_OK_SIGMA_PX}){blamed}")
    return out


def quality_document(f: Findings) -> dict[str, Any]:
    """The numbers behind the verdict."""
    a = f.adjusted
    sigma = f.sigma
    velocity = None
    if f.tied:
        group = max(f.tied, key=len)
        velocity = measured_velocity(a.motion, f.problem.times_s, group)
    nominal = float(np.hypot(*f.problem.velocity_mm_s))
    used, rows = a.weight > 0.1, row_covariances(a)
    return {
        "links": {
            kind: {"found": int(mine.sum()), "used": int((mine & used).sum())}
            for kind, mine in (("rows", f.seam < 0), ("neighbours", f.seam >= 0))
        }
        | _points_used(f),
        "unlinked": [
            {"a": list(e.task.a), "b": list(e.task.b or ()), "reason": e.note} for e in f.links if not len(e.a_px)
        ],
        "residual_px": {
            "median": _rounded(float(np.sqrt(np.median((a.link_px**2).sum(1)[used])))) if used.any() else None,
            "scatter": _rounded(a.floor_px),
            "sigma0": _rounded(a.sigma0),
        },
        "seams_px": {f"{i}-{j}": _rounded(v) for (i, j), v in f.seams_px.items()},
        "fiducials": _fiducials(f),
        "scale_error": _scale_error(f),
        "outline_contrast": _rounded(f.mapping.outline.contrast, 1) if f.mapping and f.mapping.outline else None,
        "outline_shift_mm": _shift_of(f),
        "row_sigma_px": [_rounded(v) for v in sigma.rows_px],
        "cad_sigma_px": _rounded(sigma.worst_px) if sigma.worst_px is not None else None,
        "component_sigma_px": _component_sigma(f),
        "pivot_mm": [_rounded(float(v)) for v in a.motion.pivot],
        "row_covariance": [[[_significant(v) for v in r] for r in c] for c in rows.tolist()],
        "matrix_sigma_px": [
            [pair if placed else None for pair, placed in zip(camera, f.placed, strict=True)]
            for camera in np.round(matrix_sigmas(f.scene.cameras, a.motion.pivot, rows), 4).tolist()
        ],
        "component_covariance_px2": sigma.told() if f.plane and f.plane.board_type.components else {},
        "surface_sigma_mm": _surface_sigma(f),
        "heights_mm": {address: _rounded(h.mm) for address, h in f.heights.items()},
        "height_sigma_mm": {address: _rounded(h.sigma_mm) for address, h in f.heights.items()},
        "belt": {
            "nominal_mm_s": [float(v) for v in f.problem.velocity_mm_s],
            "measured_mm_s": None if velocity is None else [_rounded(float(v)) for v in velocity],
            "speed_error": None if velocity is None else _rounded(float(np.hypot(*velocity)) / nominal - 1, 6),
        },
    }


def _points_used(f: Findings) -> dict[str, dict[str, int]]:
    """How many points known in CAD were found, and how many lie where they should, by kind."""
    points = f.mapping.problem.fiducials if f.mapping else None
    which, off = np.zeros(0, dtype=np.int_), np.zeros(0)
    if points is not None:
        which = points.which
        off = np.hypot(*f.adjusted.fiducial_px.T) / (points.sigma_mm * points.px_per_mm)
    kinds = {"fiducials": which >= 0, "fixture": which == FIXTURE, "reference": which == REFERENCE}
    return {
        kind: {"found": int(mine.sum()), "used": int((mine & (off <= _OUTLIER)).sum())} for kind, mine in kinds.items()
    }


def _fiducials(f: Findings) -> list[dict[str, Any]]:
    mapping = f.mapping
    if f.plane is None or mapping is None:
        return []
    out = []
    points = mapping.problem.fiducials
    which = points.which if points is not None else np.zeros(0, dtype=np.int_)
    for n, fiducial in enumerate(f.plane.board_type.fiducials):
        at = np.flatnonzero(which == n)
        residual = f.adjusted.fiducial_px[at].mean(0) if len(at) else None
        out.append(
            {
                "name": fiducial.name,
                "sightings": len(at),
                "residual_px": None if residual is None else [_rounded(float(v)) for v in residual],
            }
        )
    return out


def _shift_of(f: Findings) -> dict[str, Any] | None:
    shift = f.mapping.shift if f.mapping else None
    if shift is None:
        return None
    return {
        "mm": [_rounded(float(v), 3) for v in shift.mm],
        "sigma_mm": [_rounded(float(v), 3) for v in shift.sigma_mm],
        "turn_mrad": _rounded(1e3 * shift.turn_rad, 3),
        "turn_sigma_mrad": _rounded(1e3 * shift.turn_sigma_rad, 3),
        "pieces": shift.pieces,
    }


def _component_sigma(f: Findings) -> dict[str, float]:
    """Predicted standard deviation of every component that is in view, by address: the worst of its views."""
    return f.sigma.of_components if f.plane and f.mapping and f.plane.components.addresses else {}


def _surface_sigma(f: Findings) -> float | None:
    """Of the board's height, at its middle and corners the worst; None where it was not sought."""
    if f.plane is None or not len(f.adjusted.surface_mm):
        return None
    low, high = f.plane.board_type.extent()
    places = np.array([(low + high) / 2, low, high, (low[0], high[1]), (high[0], low[1])])
    return _rounded(float(surface_sigma_mm(f.plane, f.adjusted, places).max()))


def _scale_error(f: Findings) -> float | None:
    if f.plane is None or f.adjusted.similarity is None:
        return None
    a, b = f.adjusted.similarity[:2]
    return _rounded(float(np.hypot(a, b)) / f.plane.board_type.mm_per_unit - 1, 7)


def _significant(value: float) -> float:
    """Variances are small: four digits, wherever the point."""
    return float(f"{value:.4g}")


def _rounded(value: float, digits: int = 4) -> float:
    return round(value, digits)

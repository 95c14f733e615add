"""The quality document of a result: the numbers behind the verdict, as docs/formats.md describes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import measured_velocity
from vaoi_station.stitching.adjustment.problem import FIXTURE, REFERENCE
from vaoi_station.stitching.components.centres import unnoticed_mm
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.uncertainty import matrix_sigmas, row_covariances, surface_sigma_mm
from vaoi_station.stitching.quality.verdict import rows_apart

AMBIGUOUS = "ambiguous"
"""Value of `quality.orientation` if the board turned by 180° would fit as well."""
_USED = 0.1
"""Weight above which a link counts as used."""
_OUTLIER = 8.5
"""Residual above which a CAD point has no weight, in standard deviations: 6 per axis, that is 6·√2 in the plane."""


def quality_document(f: Findings) -> dict[str, Any]:
    """Collect the numbers behind the verdict of a run, as the `quality` entry of its result."""
    a = f.adjusted
    sigma = f.sigma
    velocity = None
    if f.connected_groups:
        # Only connected rows show the speed of the belt. Between groups of rows, the nominal speed was assumed.
        group = max(f.connected_groups, key=len)
        velocity = measured_velocity(a.motion, f.problem.times_s, group)
    nominal = float(np.hypot(*f.problem.velocity_mm_s))
    used, rows = a.weight > _USED, row_covariances(a)
    displacement, displacement_sigma = _displacements(f)
    return {
        "links": {
            kind: {"found": int(mine.sum()), "used": int((mine & used).sum())}
            for kind, mine in (("rows", f.problem.links.seam < 0), ("neighbours", f.problem.links.seam >= 0))
        }
        | _points_used(f),
        "unlinked": [
            {"a": list(e.task.a), "b": list(e.task.b or ()), "reason": e.note} for e in f.links if not len(e.a_px)
        ],
        "link_pairs": _link_pairs(f),
        "unplaced_rows": list(f.unplaced),
        "rows_apart": rows_apart(f),
        "residual_px": {
            "median": _rounded(float(np.sqrt(np.median((a.link_px**2).sum(1)[used])))) if used.any() else None,
            "scatter": _rounded(a.floor_px),
            "sigma0": _rounded(a.sigma0),
        },
        "seams_px": {f"{i}-{j}": _rounded(v) for (i, j), v in f.seams_px.items()},
        "camera_displacement_px": displacement,
        "camera_displacement_sigma_px": displacement_sigma,
        "fiducials": _fiducials(f),
        **_local_places(f),
        **_boards(f),
        "orientation": None if f.mapping is None else AMBIGUOUS if f.mapping.ambiguous else "certain",
        "scale_error": _scale_error(f),
        "fiducial_check": _fiducial_check(f),
        "outline_contrast": _rounded(f.mapping.outline.contrast, 1) if f.mapping and f.mapping.outline else None,
        "outline_shift_mm": _outline_shift(f),
        "row_sigma_px": [_rounded(v) for v in sigma.rows_px],
        "cad_sigma_px": _rounded(sigma.worst_px) if sigma.worst_px is not None else None,
        "component_sigma_px": _component_sigma(f),
        "pivot_mm": [_rounded(float(v)) for v in a.motion.pivot],
        "row_covariance": [[[_significant(v) for v in r] for r in c] for c in rows.tolist()],
        "matrix_sigma_px": [
            [pair if f.places(i, j) else None for j, pair in enumerate(camera)]
            for i, camera in enumerate(np.round(matrix_sigmas(f.scene.cameras, a.motion.pivot, rows), 4).tolist())
        ],
        # The views of a board without components are those of its corners, which must not be listed as components.
        "component_covariance_px2": sigma.to_json() if f.plane and f.plane.board_type.components else {},
        "surface_sigma_mm": _surface_sigma(f),
        "unseen": {
            u.address: {
                "coverage": _rounded(u.coverage),
                "views": u.views,
                "in_one_frame": u.in_one_frame,
                "cause": u.cause,
            }
            for u in f.unseen
        },
        "heights_mm": {address: _rounded(h.mm) for address, h in f.heights.items()},
        "height_sigma_mm": {address: _rounded(h.sigma_mm) for address, h in f.heights.items()},
        "belt": {
            "nominal_mm_s": [float(v) for v in f.problem.velocity_mm_s],
            "measured_mm_s": None if velocity is None else [_rounded(float(v)) for v in velocity],
            "speed_error": None if velocity is None else _rounded(float(np.hypot(*velocity)) / nominal - 1, 6),
        },
    }


def _link_pairs(f: Findings) -> list[dict[str, Any]]:
    """Return for every pair of linked frames how many links there are, where on the board, and their residual."""
    links, a = f.problem.links, f.adjusted
    if not len(links):
        return []
    count, used = len(links.groups), a.weight > _USED
    tester_from_row = np.linalg.inv(a.motion.rows_from_tester)[links.p]
    at_mm = np.einsum("kij,kj->ki", tester_from_row[:, :2, :2], links.a_mm) + tester_from_row[:, :2, 2]
    found, kept = np.bincount(links.group, minlength=count), np.bincount(links.group, used, count)

    def means(values: Floats) -> Floats:
        """Return the mean of (k,) values over the used links of each pair."""
        return np.asarray(np.bincount(links.group, values * used, count) / np.maximum(kept, 1))

    x, y, dx, dy = map(means, (*at_mm.T, *a.link_px.T))
    rms = np.sqrt(means((a.link_px**2).sum(1)))
    return [
        {
            "a": list(e.task.a),
            "b": list(e.task.b or e.task.a),
            "found": int(found[n]),
            "used": int(kept[n]),
            "at_mm": [_rounded(float(x[n]), 3), _rounded(float(y[n]), 3)] if kept[n] else None,
            "residual_px": [_rounded(float(dx[n])), _rounded(float(dy[n]))] if kept[n] else None,
            "rms_px": _rounded(float(rms[n])) if kept[n] else None,
        }
        for n, e in enumerate(links.groups)
        if found[n]
    ]


def _local_places(f: Findings) -> dict[str, Any]:
    """Return what local fiducials show of their components, by address; no entry without any."""
    places = {
        ref: {
            "fiducials": list(place.fiducials),
            "shift_mm": [_rounded(float(v)) for v in place.shift_mm],
            "turn_deg": _rounded(float(np.degrees(place.turn_rad))),
            "sigma_mm": _rounded(place.sigma_mm),
            "refusal": place.refusal or None,
        }
        for ref, place in f.own_places.local.items()
    }
    return {"local_fiducials": places} if places else {}


def _boards(f: Findings) -> dict[str, Any]:
    """Return how the boards of a panel lie against C, by position; no entry without any."""
    boards: dict[str, dict[str, Any]] = {
        position: {
            "fiducials": list(place.fiducials),
            "lost": list(place.lost),
            "shift_mm": [_rounded(float(v)) for v in place.shift_mm],
            "turn_deg": _rounded(float(np.degrees(place.turn_rad))),
            "sigma_mm": _rounded(place.sigma_mm),
            "sigma_turn_deg": _rounded(float(np.degrees(place.sigma_turn_rad))),
            "refusal": place.refusal or None,
        }
        for position, place in f.own_places.boards.items()
    }
    for position, marks in f.bad_marks.items():
        shown = [{"name": m.name, "look": m.look, "shares": m.shares, "frames": m.frames} for m in marks.marks]
        boards.setdefault(position, {}).update({"state": marks.state, "marks": shown})
    return {"boards": boards} if boards else {}


def _points_used(f: Findings) -> dict[str, dict[str, int]]:
    """Count the points with known CAD coordinates, by kind: all of them, and those that are not outliers."""
    points = f.mapping.problem.fiducials if f.mapping else None
    which, off = np.zeros(0, dtype=np.int_), np.zeros(0)
    if points is not None:
        which = points.which
        off = np.hypot(*f.adjusted.fiducial_px.T) / (points.sigma_mm * points.px_per_mm)
    kinds = {"fiducials": which >= 0, "fixture": which == FIXTURE, "reference": which == REFERENCE}
    return {
        kind: {"found": int(mine.sum()), "used": int((mine & (off <= _OUTLIER)).sum())} for kind, mine in kinds.items()
    }


def _fiducial_check(f: Findings) -> dict[str, Any] | None:
    """Return what would show that a fiducial is not at its CAD position; None without C.

    Two fiducials determine the four numbers of C and leave no residual.
    """
    points = f.mapping.problem.fiducials if f.mapping else None
    if f.plane is None or f.cad_matrix is None or points is None:
        return None
    # Fiducials of components and boards have no part in C, so they show no error of it.
    found = set(points.which[points.which >= 0].tolist())
    used = np.array(sorted(found - f.plane.board_type.apart_from_c(found, points.fixture_marks)), np.int_)
    shift = f.component_shift
    unnoticed = None
    if shift is not None and len(used) == 2:
        unnoticed = _rounded(unnoticed_mm(shift, apply(f.cad_matrix, f.plane.cad(f.plane.fiducials[used]))))
    return {
        "fiducials": len(used),
        "redundant": max(2 * len(used) - 4, 0),
        "other_points": bool((points.which < 0).any()),
        "components": 0 if shift is None else shift.components,
        "unnoticed_mm": unnoticed,
    }


def _displacements(f: Findings) -> tuple[list[list[float]], list[list[float]]] | tuple[None, None]:
    """Return x, y and turn (px) of every camera's displacement, and their σ; None if none were estimated."""
    estimate = f.adjusted.cameras
    if estimate is None:
        return None, None
    sigma = np.sqrt(np.maximum(np.diag(estimate.covariance), 0)).reshape(estimate.displacement_px.shape)
    return np.round(estimate.displacement_px, 4).tolist(), np.round(sigma, 4).tolist()


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


def _outline_shift(f: Findings) -> dict[str, Any] | None:
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
    """Return the largest predicted standard deviation over the views of each component, by address."""
    return f.sigma.of_components if f.plane and f.mapping and f.plane.components.addresses else {}


def _surface_sigma(f: Findings) -> float | None:
    """Return the largest standard deviation of the board's height at its centre and corners; None without a surface."""
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
    """Round to four significant digits. Variances are small, and fixed decimals would round them to zero."""
    return float(f"{value:.4g}")


def _rounded(value: float, digits: int = 4) -> float:
    return round(value, digits)

"""The quality document of a result: the numbers behind the verdict, as docs/formats.md describes them.

`quality_document` returns those that are known with the verdict. Those that only explain it are computed afterwards, by
`explanation`: together they take longer than the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import nlargest
from typing import Any

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import measured_velocity
from vaoi_station.stitching.adjustment.problem import FIXTURE, REFERENCE, USED
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.components.centres import unnoticed_mm
from vaoi_station.stitching.components.places import OwnPlace
from vaoi_station.stitching.matching.evidence import Detections
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.uncertainty import matrix_sigmas, row_covariances, surface_sigma_mm
from vaoi_station.stitching.quality.verdict import rows_apart

LATER = (
    "link_pairs",
    "row_covariance",
    "matrix_sigma_px",
    "component_covariance_px2",
    "heights_mm",
    "height_sigma_mm",
)
"""Names of the entries that `explanation` returns."""
AMBIGUOUS = "ambiguous"
"""Value of `quality.orientation` if the board turned by 180° would fit as well."""
_MOST_PLACES = 60


def quality_document(f: Findings) -> dict[str, Any]:
    """Collect the numbers behind the verdict of a run, as the `quality` entry of its result before it is explained."""
    unseen = {
        u.address: {
            "coverage": _rounded(u.coverage),
            "views": u.views,
            "in_one_frame": u.in_one_frame,
            "cause": u.cause,
        }
        for u in f.unseen
    }
    return {
        **_links(f),
        **_cameras(f),
        **_fiducials(f),
        **_own_places(f),
        **_board(f),
        **_uncertainties(f),
        "unseen": unseen,
        "belt": _belt(f),
    }


def fiducial_places(detections: Sequence[Detections], cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    """List the places that look most like fiducials, best first: of a board that was not found, they show why."""
    found = ((float(score), d.task.a, px) for d in detections for score, px in zip(d.score, d.px.tolist(), strict=True))
    return [
        {"frame": list(key), "px": [_rounded(v, 1) for v in px], "score": _rounded(score, 3),
         "frame_px": [cameras[key[0]].width_px, cameras[key[0]].height_px]}
        for score, key, px in nlargest(_MOST_PLACES, found)
    ]  # fmt: skip


def explanation(f: Findings) -> dict[str, Any]:
    """Collect the entries of `quality` that only explain the verdict; none of them changes it."""
    named, a = f.plane is not None and bool(f.plane.board_type.components), f.adjusted
    rows = row_covariances(a)
    return {
        "link_pairs": _link_pairs(f),
        # Variances are small, and fixed decimals would round them to zero: four significant digits.
        "row_covariance": [[[float(f"{v:.4g}") for v in r] for r in c] for c in rows.tolist()],
        "matrix_sigma_px": [
            [pair if f.places(i, j) else None for j, pair in enumerate(camera)]
            for i, camera in enumerate(np.round(matrix_sigmas(f.scene.cameras, a.motion.pivot, rows), 4).tolist())
        ],
        "component_covariance_px2": f.sigma.to_json() if named else {},
        "heights_mm": {address: _rounded(h.mm) for address, h in f.heights.items()},
        "height_sigma_mm": {address: _rounded(h.sigma_mm) for address, h in f.heights.items()},
    }


def _links(f: Findings) -> dict[str, Any]:
    a, links, which = f.adjusted, f.problem.links, f.points.which
    used, fits, across = a.weight > USED, inliers(f.points, a.fiducial_px), links.camera_a != links.camera_b
    residual_px2 = np.square(a.link_px[:, 0]) + np.square(a.link_px[:, 1])
    counted = {
        "rows": (~across, used),
        "neighbours": (across, used),
        "fiducials": (which >= 0, fits),
        "fixture": (which == FIXTURE, fits),
        "reference": (which == REFERENCE, fits),
    }
    return {
        "links": {
            kind: {"found": int(np.count_nonzero(mine)), "used": int(np.count_nonzero(mine & good))}
            for kind, (mine, good) in counted.items()
        },
        "unlinked": [
            {"a": list(e.task.a), "b": list(e.task.b or ()), "reason": e.note} for e in f.links if not len(e.a_px)
        ],
        "unplaced_rows": list(f.unplaced),
        "rows_apart": rows_apart(f),
        "residual_px": {
            "median": _rounded(float(np.sqrt(np.median(residual_px2[used])))) if used.any() else None,
            "scatter": _rounded(a.floor_px),
            "sigma0": _rounded(a.sigma0),
        },
        "seams_px": {f"{i}-{j}": _rounded(v) for (i, j), v in f.seams_px.items()},
    }


def _link_pairs(f: Findings) -> list[dict[str, Any]]:
    links, a = f.problem.links, f.adjusted
    if not len(links):
        return []
    count, used = len(links.groups), a.weight > USED
    found, kept = np.bincount(links.group, minlength=count), np.bincount(links.group, used, count)

    def means(values: Floats) -> Floats:
        """Return the mean of (k,) values over the used links of each pair."""
        return np.asarray(np.bincount(links.group, values * used, count) / np.maximum(kept, 1))

    at_mm = a.motion.board(links.p, links.a_mm)
    x, y, dx, dy, squares = (means(v).tolist() for v in (*at_mm.T, *a.link_px.T, (a.link_px**2).sum(1)))
    return [
        {
            "a": list(e.task.a),
            "b": list(e.task.b or e.task.a),
            "found": int(found[n]),
            "used": int(kept[n]),
            "at_mm": [_rounded(x[n], 3), _rounded(y[n], 3)] if kept[n] else None,
            "residual_px": [_rounded(dx[n]), _rounded(dy[n])] if kept[n] else None,
            "rms_px": _rounded(squares[n] ** 0.5) if kept[n] else None,
        }
        for n, e in enumerate(links.groups)
        if found[n]
    ]


def _cameras(f: Findings) -> dict[str, Any]:
    estimate = f.adjusted.cameras
    displacement = sigma = None
    if estimate is not None:
        displacement = np.round(estimate.displacement_px, 4).tolist()
        variance = np.maximum(np.diag(estimate.covariance), 0)
        sigma = np.round(np.sqrt(variance).reshape(estimate.displacement_px.shape), 4).tolist()
    return {"camera_displacement_px": displacement, "camera_displacement_sigma_px": sigma}


def _fiducials(f: Findings) -> dict[str, Any]:
    points, listed, check = f.points, [], None
    for n, fiducial in enumerate(f.plane.board_type.fiducials if f.plane and f.mapping else ()):
        at = np.flatnonzero(points.which == n)
        residual_px = [_rounded(v) for v in f.adjusted.fiducial_px[at].mean(0).tolist()] if len(at) else None
        listed.append({"name": fiducial.name, "sightings": len(at), "residual_px": residual_px})
    if (b := f.board) is not None:
        # Fiducials of components and boards have no part in C, so they show no error of it.
        used, shift, unnoticed = b.plane.placing(points), f.component_shift, None
        if shift is not None and len(used) == 2:
            unnoticed = _rounded(unnoticed_mm(shift, apply(b.matrix, b.plane.cad(b.plane.fiducials[used]))))
        check = {
            "fiducials": len(used),
            # Two fiducials determine the four numbers of C and leave no residual.
            "redundant": max(2 * len(used) - 4, 0),
            "other_points": bool((points.which < 0).any()),
            "components": 0 if shift is None else shift.components,
            "unnoticed_mm": unnoticed,
        }
    return {"fiducials": listed, "fiducial_check": check}


def _own_places(f: Findings) -> dict[str, Any]:

    def shown(place: OwnPlace) -> dict[str, Any]:
        return {
            "fiducials": list(place.fiducials),
            "shift_mm": [_rounded(v) for v in place.shift_mm.tolist()],
            "turn_deg": _rounded(float(np.degrees(place.turn_rad))),
            "sigma_mm": _rounded(place.sigma_mm),
            "refusal": place.refusal or None,
        }

    local = {address: shown(place) for address, place in f.own_places.local.items()}
    boards: dict[str, dict[str, Any]] = {}
    for position, place in f.own_places.boards.items():
        sigma_turn_deg = _rounded(float(np.degrees(place.sigma_turn_rad)))
        boards[position] = shown(place) | {"lost": list(place.lost), "sigma_turn_deg": sigma_turn_deg}
    for position, marks in f.bad_marks.items():
        read = [{"name": m.mark.name, "look": m.look, "shares": m.shares, "frames": m.frames} for m in marks.marks]
        boards.setdefault(position, {}).update({"state": marks.state, "marks": read})
    return ({"local_fiducials": local} if local else {}) | ({"boards": boards} if boards else {})


def _board(f: Findings) -> dict[str, Any]:
    mapping, scale_error, outline_shift = f.mapping, None, None
    if f.board is not None:
        scale = float(np.hypot(*f.board.c[:2]))
        scale_error = _rounded(scale / f.board.plane.board_type.mm_per_unit - 1, 7)
    if mapping and (shift := mapping.shift) is not None:
        outline_shift = {
            "mm": [_rounded(v, 3) for v in shift.mm.tolist()],
            "sigma_mm": [_rounded(v, 3) for v in shift.sigma_mm.tolist()],
            "turn_mrad": _rounded(1e3 * shift.turn_rad, 3),
            "turn_sigma_mrad": _rounded(1e3 * shift.turn_sigma_rad, 3),
            "pieces": shift.pieces,
        }
    return {
        "orientation": None if mapping is None else AMBIGUOUS if mapping.ambiguous else "certain",
        "scale_error": scale_error,
        "outline_contrast": _rounded(mapping.outline.contrast, 1) if mapping and mapping.outline else None,
        "outline_shift_mm": outline_shift,
    }


def _uncertainties(f: Findings) -> dict[str, Any]:
    a, sigma = f.adjusted, f.sigma
    named, surface_sigma = f.plane is not None and bool(f.plane.board_type.components), None
    if f.plane is not None and len(a.surface_mm):
        # the largest of those at the board's centre and corners
        low, high = f.plane.board_type.extent()
        places = np.array([(low + high) / 2, low, high, (low[0], high[1]), (high[0], low[1])])
        surface_sigma = _rounded(float(surface_sigma_mm(f.plane, a, places).max()))
    return {
        "row_sigma_px": [_rounded(v) for v in sigma.rows_px],
        "cad_sigma_px": _rounded(sigma.worst_px) if sigma.worst_px is not None else None,
        # The views of a board without components are those of its corners, which must not be listed as components.
        "component_sigma_px": sigma.of_components if named and f.mapping else {},
        "pivot_mm": [_rounded(v) for v in a.motion.pivot.tolist()],
        "surface_sigma_mm": surface_sigma,
    }


def _belt(f: Findings) -> dict[str, Any]:
    nominal, velocity = f.problem.velocity_mm_s, None
    if f.connected_groups:
        # Only connected rows show the speed of the belt. Between groups of rows, the nominal speed was assumed.
        velocity = measured_velocity(f.adjusted.motion, f.problem.times_s, max(f.connected_groups, key=len))
    error = None if velocity is None else float(np.hypot(*velocity)) / float(np.hypot(*nominal)) - 1
    return {
        "nominal_mm_s": nominal.tolist(),
        "measured_mm_s": None if velocity is None else [_rounded(v) for v in velocity.tolist()],
        "speed_error": None if error is None else _rounded(error, 6),
    }


def _rounded(value: float, digits: int = 4) -> float:
    return round(value, digits)

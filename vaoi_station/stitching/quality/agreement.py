"""Whether fiducials, CAD data, calibration, outline and reference agree; reasons in words and numbers if not.

Fiducials that lie where the CAD data have them fit together to a few hundredths of a pixel. If they do not, one of them
may be off by far more than its residual: bow, tilt and scale of the board, and the others, take a part of the error,
and the residual may be that of another fiducial.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from vaoi_station.geometry.robust import Failure, fit_similarity
from vaoi_station.geometry.transforms import Floats, System
from vaoi_station.model import BoardType, Reason, ReasonCode
from vaoi_station.stitching.adjustment.equations import detection_sigma_mm, fiducial_residuals
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import REFERENCE, SIGMA_MM, AdjustmentResult, FiducialPoints
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane, expected_angle, typical_camera
from vaoi_station.stitching.board.fiducials import detect_marks, find_board, merge_detections
from vaoi_station.stitching.board.outline import OutlineShift, measure_outline_contrast
from vaoi_station.stitching.board.reference import inliers
from vaoi_station.stitching.components.places import common_displacement_mm
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.frames import Scene

_FIDUCIAL_LIMIT_PX = 0.30
"""Largest error of one fiducial that is accepted, px: that of a residual, and of one of two fiducials."""
_SCALE_LIMIT = 5e-4
"""Largest accepted scale error, relative. Laminate stays below it; a wrong position of a fiducial may exceed it."""
_SURFACE_LIMIT, _SURFACE_LIMIT_TOGETHER = 4.0, 5.6
"""Largest accepted tilt, twist and bow of the board's surface, in standard deviations of their prior: each, and the
root of the sum of their squares.

A fiducial that is not at its CAD position bends the computed surface instead of leaving a residual, with three of them
as a mixture of tilt, twist and bow. Of correct boards, 1 in 10⁵ exceeds the second limit."""
_LAMINATE, _ARTWORK_MM, _PLACE_MM = 3e-4, 0.01, 0.03
"""In the search for a wrong fiducial: standard deviations of a board's relative scale, of a fiducial's position (mm),
and of its place where links alone give the motion of the rows (mm). Without the last, an error of the motion over some
rows passes for a wrong fiducial, and a right one is named."""
_PLAINLY = 4.0
"""A fiducial is named as wrong only if leaving out any other gives a χ² that is larger by at least this factor."""
_LEAST, _CONTRADICTION = 3, 4.0
"""Least number of fiducials that contradict one another, and residual of one, in standard deviations, above which they
do not fit together. Measured: right boards reach 2.3 (hostile.md)."""
_C_COLUMNS = slice(3, 5)
"""Columns of (a, b) of C in the covariance of a row, behind the row's own three unknowns."""
_LEAST_REFERRED, _LEAST_AGREEING = 12, 0.5
"""Number of points of a reference from which on they are compared with the fiducials, and least share that agrees."""
_REFERENCE_SIGMAS, _REFERENCE_LIMIT_PX = 4.0, 0.3
"""The median residual of a reference's points is a contradiction if it exceeds both: standard deviations, and px.

False links to a reference scatter about 0; points of a board that lies elsewhere do not."""
_FACTORS = (0.7, 1.4, 0.83, 1.2, 0.5, 2.0)
"""Sizes of fiducials that are searched if none were found, relative to those of the board type.

A search for one size finds marks whose size differs by up to about 15 %."""


def fiducial_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints | None, moved: Motion, px_per_mm: float
) -> list[Reason]:
    """Return a reason for each disagreement between fiducials and CAD data: residuals, scale, surface, wrong fiducial.

    `moved` is the motion of the rows from links alone, which does not depend on the fiducials.
    """
    if adjusted.similarity is None:
        return []
    out, fiducials = [], plane.board_type.fiducials
    places = _places(adjusted, points, moved)
    apart = plane.board_type.apart_from_c(places, points.fixture_marks if points is not None else 0)
    seen = {n: of for n, of in places.items() if n not in apart}
    for n, (_, off_px) in seen.items():
        if off_px > _FIDUCIAL_LIMIT_PX:
            text = f"fiducial {fiducials[n].name} lies {off_px:.2f} px from its place (limit {_FIDUCIAL_LIMIT_PX})"
            out.append(Reason(ReasonCode.FIDUCIAL_OFF_PLACE, text))
    out += _scale_reasons(plane, adjusted, px_per_mm)
    out += _surface_reasons(adjusted.surface_mm)
    if not out:
        out += contradiction_reasons(plane, adjusted, points, px_per_mm)
    # A wrong fiducial is searched only if another check fails, since correct data contain none.
    if out:
        out += _wrong_fiducial(plane, {n: place for n, (place, _) in seen.items()}, px_per_mm)
    return out


FiducialPlaces = dict[int, tuple[Floats, float]]
"""For each fiducial, by its index in the board type: its position, and the mean length of its residuals (px).

The position is in tester mm. It is computed for a flat board, with the motion of the rows from links alone."""


def _places(adjusted: AdjustmentResult, points: FiducialPoints | None, moved: Motion) -> FiducialPlaces:
    if points is None:
        return {}
    # Of the surface only the lift is used: a fiducial that is not at its CAD position bends the other terms, which
    # would hide its error.
    lift = adjusted.surface_mm[0] if len(adjusted.surface_mm) else 0.0
    place = moved.board(points.row, points.ground_mm) + moved.turned(points.row, points.lean) * lift
    off_px = np.hypot(*adjusted.fiducial_px.T)
    numbers = np.unique(points.which[points.which >= 0]).tolist()
    return {n: (place[points.which == n].mean(0), float(off_px[points.which == n].mean())) for n in numbers}


def _scale_reasons(plane: BoardPlane, adjusted: AdjustmentResult, px_per_mm: float) -> list[Reason]:
    c, mm_per_unit = adjusted.similarity, plane.board_type.mm_per_unit
    assert c is not None
    scale = float(np.hypot(*c[:2])) / mm_per_unit - 1
    if abs(scale) <= _SCALE_LIMIT:
        return []
    off_mm = abs(scale) * float(np.hypot(*np.ptp(plane.fiducials, axis=0))) * mm_per_unit
    # To two cameras, one of them displaced along the array looks like a board that lies higher and is larger.
    estimate, named = adjusted.cameras, []
    if estimate is not None:
        # C follows the displacements linearly; its first two unknowns (a, b) hold the scale.
        follow = np.linalg.solve(estimate.covariance, estimate.cross[0, _C_COLUMNS].T).T
        for camera in range(len(estimate.displacement_px)):
            instead = estimate.alone(camera)
            changed = c[:2] + follow @ (instead - estimate.displacement_px).ravel()
            sized = abs(float(np.hypot(*changed)) / mm_per_unit - 1) <= _SCALE_LIMIT
            if sized and estimate.fit(instead) >= estimate.fit(estimate.displacement_px):
                x, y, _ = instead[camera]
                named.append(f"camera {camera} is displaced by ({x:+.2f}, {y:+.2f}) px against its calibration")
    displaced = f"; or {', or '.join(named)}, which explains it as well" if named else ""
    text = (
        f"the board appears {scale:+.2%} larger than its CAD data (limit {_SCALE_LIMIT:.2%}), {off_mm:.2f} mm "
        f"({off_mm * px_per_mm:.1f} px) over its fiducials: a fiducial is not at its CAD position, the CAD data are "
        "scaled, the calibration is wrong, the board lies above or below the calibrated plane, or it is of another "
        f"type{displaced}"
    )
    return [Reason(ReasonCode.SCALE_WRONG, text)]


def _surface_reasons(surface_mm: Floats) -> list[Reason]:
    if not len(surface_mm):
        return []
    unlikely = np.abs(surface_mm / SIGMA_MM)[1:]
    together, k = float(np.hypot.reduce(unlikely)), int(unlikely.argmax())
    if unlikely[k] <= _SURFACE_LIMIT and together <= _SURFACE_LIMIT_TOGETHER:
        return []
    what = ("tilt along x", "tilt along y", "bow along x", "twist", "bow along y")[k]
    if unlikely[k] > _SURFACE_LIMIT:
        shape = f"has a {what} of {surface_mm[k + 1]:+.2f} mm (limit {_SURFACE_LIMIT * SIGMA_MM[k + 1]:.2f} mm)"
    else:
        shape = (
            f"is tilted and bent at once ({together:.1f} standard deviations together, limit "
            f"{_SURFACE_LIMIT_TOGETHER}; most of it by a {what} of {surface_mm[k + 1]:+.2f} mm)"
        )
    text = (
        f"fiducials and links agree only if the board {shape}: a fiducial is not at its CAD position, or the board is "
        "bent"
    )
    return [Reason(ReasonCode.SURFACE_UNLIKELY, text)]


def _wrong_fiducial(plane: BoardPlane, places: dict[int, Floats], px_per_mm: float) -> list[Reason]:
    """Return a reason that names the one fiducial that contradicts all others; none for fewer than three fiducials."""
    if len(places) < _LEAST:
        return []
    without = {n: _fit_without(n, plane, places) for n in places}
    costs = sorted((cost, n) for n, (cost, _) in without.items())
    (best, n), (second, _) = costs[0], costs[1]
    # A fiducial is named only if the result is clear: otherwise the engineer would search for a fault in a correct one.
    if second < _PLAINLY * max(best, 1.0):
        return []
    off_mm, name = without[n][1], plane.board_type.fiducials[n].name
    text = (
        f"without fiducial {name} the others agree: {name} lies {off_mm:.2f} mm ({off_mm * px_per_mm:.1f} px) from "
        f"its CAD position; check {name} in the CAD data and on the board"
    )
    return [Reason(ReasonCode.FIDUCIAL_WRONG, text)]


def _fit_without(n: int, plane: BoardPlane, places: dict[int, Floats]) -> tuple[float, float]:
    """Fit C to all fiducials but number n; return χ² of fit and scale, and the distance (mm) of n from its place."""
    others = [k for k in places if k != n]
    cad, board = plane.fiducials, np.array([places[k] for k in others])
    # Flat coordinates have the handedness of tester coordinates, so the fit never mirrors.
    fit = fit_similarity(board, cad[others], System.TESTER, System.CAD, mirrored=False)
    if isinstance(fit, Failure):
        return np.inf, 0.0
    misfit = fit(cad[others]) - board
    scale = fit.scale / plane.board_type.mm_per_unit - 1
    apart_mm = float(np.hypot(*np.ptp(board, axis=0)))
    cost = float((misfit**2).sum()) / (_ARTWORK_MM**2 + _PLACE_MM**2)
    cost += scale**2 / (_LAMINATE**2 + 2 * (_PLACE_MM / apart_mm) ** 2)
    return cost, float(np.hypot(*(fit(cad[n]) - places[n])))


def contradiction_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints | None, px_per_mm: float
) -> list[Reason]:
    """Return a reason if fiducials do not fit together, and the error of one that would explain it is too large.

    Each is left out in turn: its distance from the place that the rest predicts is the error that would explain all.
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
    every = {n: _without(adjusted, n, [k for k in used if k != n]) for n in used}
    # Those without which the others still do not fit are left out, unless that holds for all.
    errors = {n: mm for n, (mm, sigmas) in every.items() if sigmas <= _CONTRADICTION}
    errors = errors or {n: mm for n, (mm, _) in every.items()}
    if max(errors.values(), default=0.0) * px_per_mm <= _FIDUCIAL_LIMIT_PX:
        return []
    names, (px, sigmas) = [fiducial.name for fiducial in plane.board_type.fiducials], off[worst]
    each = ", or ".join(f"{names[n]} by {mm:.2f} mm ({mm * px_per_mm:.1f} px)" for n, mm in errors.items())
    text = (
        f"the fiducials do not fit together: {names[worst]} lies {px:.2f} px from its place, {sigmas:.0f} standard "
        f"deviations; one that is not at its CAD position would explain it, {each} (limit {_FIDUCIAL_LIMIT_PX} px); "
        "check them in the CAD data and on the board"
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


def _without(adjusted: AdjustmentResult, n: int, others: Collection[int]) -> tuple[float, float]:
    """Adjust the run without fiducial n; return its distance (mm) from its place, and the others' largest residual.

    The cameras stay where the adjustment has found them. The residual is in standard deviations.
    """
    problem, points, c = adjusted.problem, adjusted.problem.fiducials, adjusted.similarity
    assert points is not None
    assert c is not None
    own, rest, surface = np.flatnonzero(points.which == n), np.flatnonzero(points.which != n), problem.surface
    basis = surface.at_fiducials if surface else np.zeros((len(points.which), 0))
    kept = surface and replace(surface, at_fiducials=basis[rest])
    fitted = adjust(replace(problem, fiducials=points.select(rest), surface=kept, cameras=()), adjusted.motion, c)
    assert fitted.similarity is not None
    alone = points.select(own)
    off_mm = fiducial_residuals(alone, fitted.motion, fitted.similarity, basis[own], fitted.surface_mm)[0]
    misfits = _residuals(points.select(rest), fitted.fiducial_px, others)
    return float(np.hypot(*off_mm.mean(0))), max(sigmas for _, sigmas in misfits.values())


def common_local_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints | None, px_per_mm: float
) -> list[Reason]:
    """Return a reason if local fiducials together lie elsewhere than C puts them, where only two fiducials place C.

    Two fiducials leave no residuals, and the places of components would follow the error of one of them.
    """
    if adjusted.similarity is None or points is None or (points.which < 0).any():
        return []
    found = set(points.which.tolist())
    if len(found - plane.board_type.apart_from_c(found)) > 2:
        return []
    off_mm = common_displacement_mm(plane, adjusted, points, plane.matrix(adjusted.similarity))
    if off_mm * px_per_mm <= _FIDUCIAL_LIMIT_PX:
        return []
    text = (
        f"the local fiducials together lie up to {off_mm:.2f} mm ({off_mm * px_per_mm:.1f} px) from where the two "
        f"others put them (limit {_FIDUCIAL_LIMIT_PX} px): one of these two is not at its CAD position, or another "
        "mark was taken for it; check both in the CAD data and on the board"
    )
    return [Reason(ReasonCode.FIDUCIAL_OFF_PLACE, text)]


def uncertain_detections(plane: BoardPlane, points: FiducialPoints | None, limit_px: float) -> str:
    """Return a clause that names fiducials whose best detection has a σ above a limit (px); empty if none."""
    if points is None:
        return ""
    sigma_px, found = points.sigma_mm * points.px_per_mm, set(points.which[points.which >= 0].tolist())
    numbers = sorted(found - plane.board_type.apart_from_c(found, points.fixture_marks))
    best = {n: float(sigma_px[points.which == n].min()) for n in numbers}
    unsure = ", ".join(f"{plane.board_type.fiducials[n].name} ± {px:.2f} px" for n, px in best.items() if px > limit_px)
    return f"; fiducials that are partly covered, smudged or in a glare: {unsure}" if unsure else ""


def outline_reasons(shift: OutlineShift | None, px_per_mm: float) -> list[Reason]:
    """Return a reason if the outline is shifted or turned against the position that the fiducials predict."""
    out = []
    if shift is not None and shift.excess_mm:
        (x, y), (sx, sy) = shift.mm, shift.sigma_mm
        text = (
            f"the board's outline lies {shift.excess_mm:.2f} mm ({shift.excess_mm * px_per_mm:.0f} px) from where "
            f"the fiducials put it, ({x:+.2f}, {y:+.2f}) mm ± ({sx:.2f}, {sy:.2f}) over {shift.pieces} places: "
            "other marks may have been taken for the fiducials; compare fiducials and outline of the board type "
            "with the board"
        )
        out.append(Reason(ReasonCode.OUTLINE_SHIFTED, text))
    if shift is not None and shift.turned_mm:
        turn, sigma = 1e3 * shift.turn_rad, 1e3 * shift.turn_sigma_rad
        text = (
            f"the board's outline is turned by {turn:+.1f} ± {sigma:.1f} mrad against the fiducials, "
            f"{shift.turned_mm:.2f} mm ({shift.turned_mm * px_per_mm:.0f} px) at its ends: a fiducial is not at "
            "its CAD position, or another mark was taken for it"
        )
        out.append(Reason(ReasonCode.OUTLINE_TURNED, text))
    return out


def reference_reasons(points: FiducialPoints | None, residual_px: Floats) -> list[Reason]:
    """Return a reason if most points of a reference lie elsewhere than the fiducials put them, and agree about it."""
    if points is None or not (points.which >= 0).any():
        return []
    referred = points.which == REFERENCE
    count, fitting = int(referred.sum()), int((inliers(points, residual_px) & referred).sum())
    if count < _LEAST_REFERRED or fitting >= _LEAST_AGREEING * count:
        return []
    off = residual_px[referred]
    median = np.median(off, axis=0)
    # 1.4826: from the median absolute deviation to the standard deviation; 1.2533: from a mean's to a median's.
    sigma = 1.2533 * 1.4826 * np.median(np.abs(off - median), axis=0) / np.sqrt(count)
    length = float(np.hypot(*median))
    if length < max(_REFERENCE_LIMIT_PX, _REFERENCE_SIGMAS * float(np.hypot(*sigma))):
        return []
    text = (
        f"only {fitting} of {count} points of the reference lie where the fiducials put them (limit "
        f"{_LEAST_AGREEING:.0%}); their median is {length:.2f} px away: another mark was taken for a fiducial, "
        "the board is of another type, or the CAD data were changed; compare board and board type, or teach again"
    )
    return [Reason(ReasonCode.REFERENCE_CONTRADICTS, text)]


def wrong_size(
    board_type: BoardType, scene: Scene, expectation: Expectation, motion: Motion, texture_mm: Floats
) -> Reason | None:
    """Return a reason if marks of another size lie where the fiducials, which were not found, should be.

    The search for fiducials finds only marks of about the stated size. If marks of another size lie at the distances
    of the fiducials, and the outline is visible where they put it, the diameter in the board type is wrong.
    """
    costs = []
    for factor in _FACTORS:
        resized = tuple(f.model_copy(update={"diameter": f.diameter * factor}) for f in board_type.fiducials)
        other = board_type.model_copy(update={"fiducials": resized})
        cost = _cost_of_size(other, scene, expectation, motion, texture_mm)
        costs += [] if cost is None else [(cost, factor)]
    if not costs:
        return None
    _, factor = min(costs, key=lambda found: found[0])
    stated = [size * board_type.mm_per_unit for size in sorted({f.diameter for f in board_type.fiducials})]
    text = (
        f"marks of {', '.join(f'about {mm * factor:.2g} mm' for mm in stated)} are where fiducials of "
        f"{', '.join(f'{mm:.2g} mm' for mm in stated)} are expected: correct the diameter of the fiducials in the "
        "board type"
    )
    return Reason(ReasonCode.FIDUCIAL_SIZE, text)


def _cost_of_size(
    board_type: BoardType, scene: Scene, expectation: Expectation, motion: Motion, texture_mm: Floats
) -> float | None:
    """Return the cost of the best position of the board; None if no position is found or confirmed."""
    plane, cameras = board_plane(board_type, scene.cameras[0]), scene.cameras
    detections = [
        detect_marks(Task("marks", key), scene.prepared(key), cameras[key[0]], board_type) for key in scene.present
    ]
    places = merge_detections(detections, cameras, motion)
    angle = expected_angle(plane, typical_camera(cameras), expectation)
    found = find_board(plane, places, angle, expectation, np.asarray(texture_mm))
    if isinstance(found, Failure):
        return None
    outline = measure_outline_contrast(board_type, plane.matrix(found.c), scene, motion)
    if len(found.fiducials) < min(_LEAST, len(board_type.fiducials)) or (outline is not None and not outline.visible):
        return None
    # With fewer fiducials, the outline must confirm the board's position.
    return found.cost if outline is not None or len(found.fiducials) >= _LEAST else None

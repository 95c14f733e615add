"""Whether fiducials, CAD data, calibration, outline and reference agree; reasons in words and numbers if not.

Of fiducials that do not fit together, one may be off by far more than its residual: bow, tilt and scale of the board,
and the others, take a part of the error, and the residual may be that of another fiducial.
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
"""Largest accepted tilt, twist and bow of the surface, in standard deviations of their prior: each, and the root of the
sum of their squares, which 1 in 10⁵ correct boards exceeds. A wrong fiducial bends the surface, with three of them as a
mixture."""
_LAMINATE, _ARTWORK_MM, _PLACE_MM = 3e-4, 0.01, 0.03
"""In the search for a wrong fiducial: standard deviations of a board's relative scale, of a fiducial's position (mm),
and of its place where links alone give the motion of the rows (mm)."""
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
"""The median residual of a reference's points is a contradiction if it exceeds both: standard deviations, and px."""
_FACTORS = (0.7, 1.4, 0.83, 1.2, 0.5, 2.0)
"""Sizes of fiducials that are searched if none were found, relative to those of the board type; each search finds marks
whose size differs by up to about 15 %."""


def fiducial_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, moved: Motion, px_per_mm: float
) -> list[Reason]:
    """Return a reason for each disagreement between fiducials and CAD data: residuals, scale, surface, wrong fiducial.

    `moved` is the motion of the rows from links alone, which does not depend on the fiducials.
    """
    if adjusted.similarity is None:
        return []
    # Of the surface only the lift is used: a fiducial that is not at its CAD position bends the other terms, which
    # would hide its error.
    lift = adjusted.surface_mm[0] if len(adjusted.surface_mm) else 0.0
    place = moved.board(points.row, points.ground_mm) + moved.turned(points.row, points.lean) * lift
    off_px = np.hypot(*adjusted.fiducial_px.T)
    used, out = plane.placing(points), []
    for n in used:
        if (off := float(off_px[points.which == n].mean())) > _FIDUCIAL_LIMIT_PX:
            name = plane.board_type.fiducials[n].name
            text = f"fiducial {name} lies {off:.2f} px from its place (limit {_FIDUCIAL_LIMIT_PX})"
            out.append(Reason(ReasonCode.FIDUCIAL_OFF_PLACE, text))
    out += _scale_reasons(plane, adjusted, px_per_mm)
    out += _surface_reasons(adjusted.surface_mm)
    if not out:
        out += contradiction_reasons(plane, adjusted, points, px_per_mm)
    # A wrong fiducial is searched only if another check fails, since correct data contain none.
    if out:
        out += _wrong_fiducial(plane, {n: place[points.which == n].mean(0) for n in used}, px_per_mm)
    return out


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
    text = f"fiducials and links agree only if the board {shape}"
    return [Reason(ReasonCode.SURFACE_UNLIKELY, f"{text}: a fiducial is not at its CAD position, or the board is bent")]


def _wrong_fiducial(plane: BoardPlane, places: dict[int, Floats], px_per_mm: float) -> list[Reason]:
    if len(places) < _LEAST:
        return []
    costs = []
    for n, place in places.items():
        # χ² of fit and scale without fiducial n. Flat coordinates have the handedness of tester coordinates.
        others = [k for k in places if k != n]
        cad, board = plane.fiducials, np.array([places[k] for k in others])
        fit = fit_similarity(board, cad[others], System.TESTER, System.CAD, mirrored=False)
        if isinstance(fit, Failure):
            costs.append((np.inf, n, 0.0))
            continue
        scale, apart_mm = fit.scale / plane.board_type.mm_per_unit - 1, float(np.hypot(*np.ptp(board, axis=0)))
        cost = float(((fit(cad[others]) - board) ** 2).sum()) / (_ARTWORK_MM**2 + _PLACE_MM**2)
        cost += scale**2 / (_LAMINATE**2 + 2 * (_PLACE_MM / apart_mm) ** 2)
        costs.append((cost, n, float(np.hypot(*(fit(cad[n]) - place)))))
    (best, n, off_mm), (second, *_) = sorted(costs)[:2]
    # A fiducial is named only if the result is clear: otherwise the engineer would search for a fault in a correct one.
    if second < _PLAINLY * max(best, 1.0):
        return []
    name = plane.board_type.fiducials[n].name
    text = (
        f"without fiducial {name} the others agree: {name} lies {off_mm:.2f} mm ({off_mm * px_per_mm:.1f} px) from "
        f"its CAD position; check {name} in the CAD data and on the board"
    )
    return [Reason(ReasonCode.FIDUCIAL_WRONG, text)]


def contradiction_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, px_per_mm: float
) -> list[Reason]:
    """Return a reason if fiducials do not fit together, and the error of one that would explain it is too large."""
    if adjusted.similarity is None or (points.which < 0).any():
        return []
    used = plane.placing(points)
    if len(used) < _LEAST:
        return []
    off = _residuals(points, adjusted.fiducial_px, used)
    worst, (px, sigmas) = max(off.items(), key=lambda item: item[1][1])
    if sigmas <= _CONTRADICTION:
        return []
    every = {n: _without(adjusted, n, [k for k in used if k != n]) for n in used}
    # Those without which the others still do not fit are left out, unless that holds for all.
    errors = {n: mm for n, (mm, left) in every.items() if left <= _CONTRADICTION}
    errors = errors or {n: mm for n, (mm, _) in every.items()}
    if max(errors.values(), default=0.0) * px_per_mm <= _FIDUCIAL_LIMIT_PX:
        return []
    names = [fiducial.name for fiducial in plane.board_type.fiducials]
    each = ", or ".join(f"{names[n]} by {mm:.2f} mm ({mm * px_per_mm:.1f} px)" for n, mm in errors.items())
    text = (
        f"the fiducials do not fit together: {names[worst]} lies {px:.2f} px from its place, {sigmas:.0f} standard "
        f"deviations; one that is not at its CAD position would explain it, {each} (limit {_FIDUCIAL_LIMIT_PX} px); "
        "check them in the CAD data and on the board"
    )
    return [Reason(ReasonCode.FIDUCIAL_OFF_PLACE, text)]


def _residuals(points: FiducialPoints, off_px: Floats, used: Collection[int]) -> dict[int, tuple[float, float]]:
    weight = (detection_sigma_mm(points) * points.px_per_mm) ** -2.0
    out = {}
    for n in used:
        own = points.which == n
        px = float(np.hypot(*np.average(off_px[own], axis=0, weights=weight[own])))
        out[n] = px, px * float(np.sqrt(weight[own].sum()))
    return out


def _without(adjusted: AdjustmentResult, n: int, others: Collection[int]) -> tuple[float, float]:
    """Adjust the run without fiducial n, with the same cameras."""
    problem, points, c = adjusted.problem, adjusted.problem.fiducials, adjusted.similarity
    assert points is not None
    assert c is not None
    own, rest, surface = np.flatnonzero(points.which == n), np.flatnonzero(points.which != n), problem.surface
    basis = surface.at_fiducials if surface else np.zeros((len(points.which), 0))
    kept = surface and replace(surface, at_fiducials=basis[rest])
    fitted = adjust(replace(problem, fiducials=points.select(rest), surface=kept, cameras=()), adjusted.motion, c)
    assert fitted.similarity is not None
    off_mm = fiducial_residuals(points.select(own), fitted.motion, fitted.similarity, basis[own], fitted.surface_mm)[0]
    misfits = _residuals(points.select(rest), fitted.fiducial_px, others)
    return float(np.hypot(*off_mm.mean(0))), max(sigmas for _, sigmas in misfits.values())


def common_local_reasons(
    plane: BoardPlane, adjusted: AdjustmentResult, points: FiducialPoints, px_per_mm: float
) -> list[Reason]:
    """Return a reason if local fiducials together lie elsewhere than C puts them, where only two fiducials place C."""
    if adjusted.similarity is None or (points.which < 0).any() or len(plane.placing(points)) > 2:
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


def uncertain_detections(plane: BoardPlane, points: FiducialPoints, limit_px: float) -> str:
    """Return a clause that names fiducials whose best detection has a σ above a limit (px); empty if none."""
    sigma_px = points.sigma_mm * points.px_per_mm
    best = {n: float(sigma_px[points.which == n].min()) for n in plane.placing(points)}
    unsure = ", ".join(f"{plane.board_type.fiducials[n].name} ± {px:.2f} px" for n, px in best.items() if px > limit_px)
    return f"; fiducials that are partly covered, smudged or in a glare: {unsure}" if unsure else ""


def outline_reasons(shift: OutlineShift | None, px_per_mm: float) -> list[Reason]:
    """Return a reason if the outline is shifted or turned against the position that the fiducials predict."""
    if shift is None:
        return []
    out = []
    if shift.excess_mm:
        (x, y), (sx, sy) = shift.mm, shift.sigma_mm
        text = (
            f"the board's outline lies {shift.excess_mm:.2f} mm ({shift.excess_mm * px_per_mm:.0f} px) from where "
            f"the fiducials put it, ({x:+.2f}, {y:+.2f}) mm ± ({sx:.2f}, {sy:.2f}) over {shift.pieces} places: "
            "other marks may have been taken for the fiducials; compare fiducials and outline of the board type "
            "with the board"
        )
        out.append(Reason(ReasonCode.OUTLINE_SHIFTED, text))
    if shift.turned_mm:
        turn, sigma = 1e3 * shift.turn_rad, 1e3 * shift.turn_sigma_rad
        text = (
            f"the board's outline is turned by {turn:+.1f} ± {sigma:.1f} mrad against the fiducials, "
            f"{shift.turned_mm:.2f} mm ({shift.turned_mm * px_per_mm:.0f} px) at its ends: a fiducial is not at "
            "its CAD position, or another mark was taken for it"
        )
        out.append(Reason(ReasonCode.OUTLINE_TURNED, text))
    return out


def reference_reasons(points: FiducialPoints, residual_px: Floats) -> list[Reason]:
    """Return a reason if most points of a reference lie elsewhere than the fiducials put them, and agree about it."""
    if not (points.which >= 0).any():
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
    """Return a reason if marks of another size lie where the fiducials, which were not found, should be."""
    cameras, costs = scene.cameras, []
    for factor in _FACTORS:
        resized = tuple(f.model_copy(update={"diameter": f.diameter * factor}) for f in board_type.fiducials)
        other = board_type.model_copy(update={"fiducials": resized})
        plane = board_plane(other, cameras[0])
        detections = [
            detect_marks(Task("marks", key), scene.prepared(key), cameras[key[0]], other) for key in scene.present
        ]
        angle = expected_angle(plane, typical_camera(cameras), expectation)
        found = find_board(plane, merge_detections(detections, cameras, motion), angle, expectation, texture_mm)
        if isinstance(found, Failure):
            continue
        outline = measure_outline_contrast(other, plane.matrix(found.c), scene, motion)
        count = len(found.fiducials)
        # With fewer fiducials, the outline must confirm the board's position.
        confirmed = count >= _LEAST if outline is None else outline.visible
        if confirmed and count >= min(_LEAST, len(resized)):
            costs.append((found.cost, factor))
    if not costs:
        return None
    factor = min(costs, key=lambda found: found[0])[1]
    stated = [size * board_type.mm_per_unit for size in sorted({f.diameter for f in board_type.fiducials})]
    text = (
        f"marks of {', '.join(f'about {mm * factor:.2g} mm' for mm in stated)} are where fiducials of "
        f"{', '.join(f'{mm:.2g} mm' for mm in stated)} are expected: correct the diameter of the fiducials in the "
        "board type"
    )
    return Reason(ReasonCode.FIDUCIAL_SIZE, text)

"""Check a board type against a stitched run: residuals, what is absent, a correction, and a picture of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.correction import Group, Move, moved_board_type
from vaoi_station.board_check.overview import CheckedRun
from vaoi_station.board_check.pose_search import BodyEdges, Pose, find_poses, middle_of, refine_pose, shares_weaker
from vaoi_station.board_check.report import BoardCheck, CheckedFiducial, CheckWarning, Residual, Unlikely
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.marks import Mark, locate_mark
from vaoi_station.model import BoardType
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane, expected_angle, typical_camera
from vaoi_station.stitching.components.centres import central_views, measure_component_shift
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.geometry import ComponentIndex


def distances_of_marks(run: CheckedRun, board: BoardType, tester_from_cad: Floats) -> list[float]:
    """Return for each fiducial the distance of the mark that is there from its stated place, mm; NaN for none.

    Each is searched in the frame that shows it nearest to its centre; if it is not found there, in the nearest frame of
    every other light, because a mark may have no contrast under one.
    """
    views = run.views(np.array([(f.x, f.y) for f in board.fiducials]).reshape(-1, 2), tester_from_cad)
    present, out = set(run.scene.present), []
    frames = [(int(camera), int(row)) for camera, row in zip(views.camera, views.row, strict=True)]
    for n, fiducial in enumerate(board.fiducials):
        shown = [k for k in np.flatnonzero(views.point == n).tolist() if frames[k] in present]
        nearest: dict[str, int] = {}
        for k in sorted(shown, key=lambda k: float(np.hypot(*(views.px[k] - run.cameras[frames[k][0]].center_px)))):
            nearest.setdefault(run.lights[frames[k][1]] if run.lights else "", k)
        out.append(math.nan)
        for k in nearest.values():
            resolution = run.cameras[frames[k][0]].px_per_mm
            diameter_px = fiducial.diameter * board.mm_per_unit * resolution
            mark = locate_mark(run.scene.prepared(frames[k]).grey, views.px[k], fiducial.shape, diameter_px)
            if isinstance(mark, Mark):
                out[-1] = float(np.hypot(*(mark.px - views.px[k]))) / resolution
                break
    return out


LEAST_COMPONENTS = 3
_LEAST_SCORE, _LEAST_LEAD = 6.0, 1.0
"""Least score of a pose that is found, and least distance to that of the best other one.

Data of another board reach 4.5 to 5.5; data of the board in the pictures 7 on photographs and 17 on drawings."""
_NEAR_MM = 2.0
"""Largest rms distance of the bodies at a pose from where C of the run puts them, for this C to confirm the pose."""
_UNKNOWN_RAD = np.radians(np.arange(-2.0, 2.01, 0.5))
"""Angles that are tried, about that of an upright board, if the run has no C."""
_UNLIKELY = 0.5
_MISSING_SHARE = 0.15
"""Share of unlikely components from which on the data are probably of another revision."""
_SIGNIFICANT = 3.0
_LEAST_MM = 0.05
"""Displacements up to this are no reason for a correction: placement of parts and light cause as much."""
_SAME_OUTLINE_MM = 0.5
_NO_MARK_MM = 1.0
"""Distance that counts for a fiducial where no mark is found."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """Where the components lie."""

    pose: Pose
    covariance: Floats
    """(4, 4) of shift at the middle, turn and stretch, mm."""
    arm_mm: float
    measured: int


def check_board(run: CheckedRun, board_type: BoardType) -> BoardCheck:
    """Lay a board type over a run, which may have been stitched with another one.

    Raises:
        InputError: the board type has too few components, or is larger than what was filmed.
        StateError: the run has no placed frame.
    """
    _check_size(run, board_type)
    edges = BodyEdges.of(board_type)
    plane = board_plane(board_type, typical_camera(run.cameras))
    poses = find_poses(run.overview, edges, _angles(run, plane))
    given, to_mm = run.stated_matrix(board_type), np.diag([board_type.mm_per_unit, board_type.mm_per_unit, 1.0])
    # Bodies of a layout that is symmetric about a point fit as well turned by 180°; the run's C decides.
    near = None if given is None else _pose_at(poses, edges, given @ np.linalg.inv(to_mm))
    best = poses[0] if near is None else near
    rival = max(pose.score for pose in poses if pose is not best)
    report = BoardCheck(
        board_type=board_type.name,
        score=round(best.score, 2),
        rival_score=round(rival, 2),
        components=len(board_type.components),
        measured=0,
    )
    if best.score < _LEAST_SCORE or (near is None and best.score < rival + _LEAST_LEAD):
        text = (
            f"the components are not found in the pictures: the best pose scores {best.score:.1f} (limit "
            f"{_LEAST_SCORE:g}), another one {rival:.1f} (at least {_LEAST_LEAD:g} less is needed). The data are of "
            "another board or side, or too few bodies have edges that show."
        )
        return _with(report, warnings=[CheckWarning(code="not-found", message=text)])
    fit = _measured(run, plane, edges, best)
    c = fit.pose.matrix @ to_mm
    shares = shares_weaker(run.overview, edges, fit.pose.matrix)
    parts = board_type.components
    unlikely = [
        Unlikely(ref=parts[n].address, share=round(float(shares[n]), 2))
        for n in np.argsort(shares)
        if shares[n] < _UNLIKELY
    ]
    not_filmed = [p.address for p, share in zip(parts, shares, strict=True) if math.isnan(share)]
    c_rows, measured = c.tolist(), fit.measured
    report = _with(report, tester_from_cad=c_rows, measured=measured, unlikely=unlikely, not_filmed=not_filmed)
    warnings = _about_components(report)
    if given is None:
        text = "the run has no CAD mapping, so residuals and a correction cannot be stated."
        warnings = [*_about_side(fit.pose.mirrored != plane.mirrored), *warnings]
        warnings.append(CheckWarning(code="no-cad-mapping", message=text))
        return _with(report, warnings=warnings)
    move, residual = _residual(fit, edges, given, board_type)
    found = distances_of_marks(run, board_type, given), distances_of_marks(run, board_type, c)
    fiducials = [
        CheckedFiducial(name=f.name, off_mm=_rounded(stated), off_corrected_mm=_rounded(moved))
        for f, stated, moved in zip(board_type.fiducials, *found, strict=True)
    ]
    corrects = _about_residual(residual, fit.arm_mm)
    warnings = [*corrects, *_about_fiducials(fiducials), *warnings]
    report = _with(report, residual=residual, fiducials=fiducials, warnings=warnings)
    return _with_proposal(report, run, board_type, move) if corrects else report


def _with(report: BoardCheck, **change: object) -> BoardCheck:
    return report.model_copy(update=change)


def _pose_at(poses: Sequence[Pose], edges: BodyEdges, stated: Floats) -> Pose | None:
    """Return the pose at which C from CAD data in mm puts the bodies, if no other one, the best first, fits better."""
    there = apply(stated, edges.points)
    for pose in poses:
        off_mm = np.sqrt(((apply(pose.matrix, edges.points) - there) ** 2).sum(1).mean())
        if off_mm < _NEAR_MM and pose.score > poses[0].score - _LEAST_LEAD:
            return pose
    return None


def _check_size(run: CheckedRun, board: BoardType) -> None:
    if len(board.components) < LEAST_COMPONENTS:
        raise InputError.field(
            board.name, "components", f"{len(board.components)} entries", f"at least {LEAST_COMPONENTS} to be checked"
        )
    corners = BodyEdges.of(board).points
    extent = np.sort(np.ptp(corners, axis=0))
    filmed = np.sort(np.array(run.overview.grey.shape) / run.overview.px_per_mm)
    if (extent > 1.5 * filmed).any():
        raise InputError(
            f"{board.name}: its components extend over {extent[1]:.0f} × {extent[0]:.0f} mm, but {filmed[1]:.0f} × "
            f"{filmed[0]:.0f} mm were filmed.",
            action=f"Check the unit of the data, {board.unit!r}.",
        )


def _angles(run: CheckedRun, plane: BoardPlane) -> list[float]:
    c = run.stitch.cad_matrix
    if c is not None:
        return [math.atan2(c[1][0], c[0][0])]
    upright = expected_angle(plane, typical_camera(run.cameras), Expectation())
    return [float(upright + a) for a in _UNKNOWN_RAD]


def _measured(run: CheckedRun, plane: BoardPlane, edges: BodyEdges, pose: Pose) -> _Fit:
    """Refine a pose by edges, then by the centres of components in the frames, if enough of them show."""
    pose, covariance = refine_pose(run.overview, edges, pose)
    _, arm = middle_of(edges)
    mm = plane.board_type.mm_per_unit
    seen = BoardPlane(plane.board_type, pose.mirrored)
    fit = _Fit(pose, covariance, arm, 0)
    # Centres are searched within 0.3 mm; the second time they are near.
    for _ in range(2):
        c = fit.pose.matrix @ np.diag([mm, mm, 1.0])
        views = central_views(seen, c, run.scene, run.motion, run.views(seen.components.center, c))
        shift = measure_component_shift(seen, c, run.scene, run.motion, views)
        if shift is None:
            return fit
        dx, dy, turn, stretch = shift.measured
        change = np.eye(3)
        change[:2, :2] += np.array([[stretch, -turn], [turn, stretch]]) / shift.arm_mm
        change[:2, 2] = np.array([dx, dy]) - (change[:2, :2] - np.eye(2)) @ shift.middle_mm
        pose = _pose_of(change @ fit.pose.matrix, fit.pose)
        fit = _Fit(pose, shift.covariance, shift.arm_mm, shift.components)
    return fit


def _pose_of(matrix: Floats, pose: Pose) -> Pose:
    scale = math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))
    angle = math.atan2(matrix[1, 0], matrix[0, 0])
    return replace(pose, angle_rad=angle, scale=scale, shift_mm=(float(matrix[0, 2]), float(matrix[1, 2])))


def _residual(fit: _Fit, edges: BodyEdges, given: Floats, board: BoardType) -> tuple[Move, Residual]:
    mm, up = board.mm_per_unit, 1.0 if board.y_axis == "up" else -1.0
    to_up = np.diag([mm, up * mm, 1.0])
    c = fit.pose.matrix @ np.diag([mm, mm, 1.0])
    matrix = to_up @ np.linalg.inv(given) @ c @ np.linalg.inv(to_up)
    middle = middle_of(edges)[0] * (1.0, up)
    # Shifts were measured in tester coordinates; their covariance is turned into those of the data.
    turn = (to_up @ np.linalg.inv(given))[:2, :2]
    shift_covariance = turn @ fit.covariance[:2, :2] @ turn.T
    sigma = np.sqrt(np.diag(shift_covariance)), np.sqrt(np.diag(fit.covariance)[2:]) / fit.arm_mm
    move = Move.of(matrix, middle)
    return move.snapped(math.degrees(sigma[1][0]), float(sigma[1][1])), Residual(
        mirrored=move.mirrored,
        rotation_deg=round(move.degrees, 4),
        rotation_sigma_deg=round(math.degrees(sigma[1][0]), 4),
        scale=round(move.scale, 6),
        scale_sigma=round(float(sigma[1][1]), 6),
        shift_mm=(round(move.shift_mm[0], 4), round(move.shift_mm[1], 4)),
        shift_sigma_mm=(round(float(sigma[0][0]), 4), round(float(sigma[0][1]), 4)),
    )


def _about_residual(residual: Residual, arm_mm: float) -> list[CheckWarning]:
    """Return a warning for every residual that is more than noise and placement of parts explain."""
    out = _about_side(residual.mirrored)
    quarter = round(residual.rotation_deg / 90) % 4
    rest = residual.rotation_deg - 90 * round(residual.rotation_deg / 90)
    turned = abs(math.radians(rest)) * arm_mm > _LEAST_MM and abs(rest) > _SIGNIFICANT * residual.rotation_sigma_deg
    if quarter or turned:
        text = f"the components lie turned by {residual.rotation_deg:.2f} ± {residual.rotation_sigma_deg:.2f}°."
        out.append(CheckWarning(code="turned", message=text))
    off = abs(residual.scale - 1)
    if off * arm_mm > _LEAST_MM and off > _SIGNIFICANT * residual.scale_sigma:
        text = f"distances in the pictures are {residual.scale:.4f} ± {residual.scale_sigma:.4f} of those in the data."
        out.append(CheckWarning(code="scaled", message=text))
    shift, sigma = math.hypot(*residual.shift_mm), math.hypot(*residual.shift_sigma_mm)
    if shift > _LEAST_MM and shift > _SIGNIFICANT * sigma:
        x, y = residual.shift_mm
        text = f"the components lie shifted by ({x:.3f}, {y:.3f}) mm, ± {sigma:.3f} mm."
        out.append(CheckWarning(code="shifted", message=text))
    return out


def _about_side(mirrored: bool) -> list[CheckWarning]:
    if not mirrored:
        return []
    text = (
        "the components lie mirrored: the data are of the other side, or exported as seen from below. After the "
        "correction check the rotations of polarised parts."
    )
    return [CheckWarning(code="mirrored", message=text)]


def _about_components(report: BoardCheck) -> list[CheckWarning]:
    """Return a warning if the count of components that seem absent points to another revision."""
    filmed = report.components - len(report.not_filmed)
    if len(report.unlikely) < max(3, _MISSING_SHARE * filmed):
        return []
    refs = ", ".join(entry.ref for entry in report.unlikely[:8])
    more = len(report.unlikely) - 8
    text = (
        f"{len(report.unlikely)} of {filmed} components do not look as if they were there: {refs}"
        f"{f' and {more} more' if more > 0 else ''}. The data may be of another revision."
    )
    return [CheckWarning(code="components-missing", message=text)]


def _about_fiducials(fiducials: list[CheckedFiducial]) -> list[CheckWarning]:
    lost = [f.name for f in fiducials if f.off_mm is None]
    if not lost:
        return []
    text = f"no mark is found where the data put {', '.join(lost[:8])}."
    return [CheckWarning(code="fiducials-elsewhere", message=text)]


def _with_proposal(report: BoardCheck, run: CheckedRun, board: BoardType, move: Move) -> BoardCheck:
    """Add the corrected board type; what is found where it is stated stays there."""
    groups: list[Group] = ["components"]

    def off(values: list[float | None]) -> float:
        return sum(_NO_MARK_MM if value is None else min(value, _NO_MARK_MM) for value in values)

    marks_move = off([f.off_corrected_mm for f in report.fiducials]) < off([f.off_mm for f in report.fiducials])
    if marks_move:
        groups.append("fiducials")
    if not _same_outline(run.board_type, board) and marks_move:
        groups.append("outline")
    try:
        proposal = moved_board_type(board, move, tuple(groups))
    except ValueError as error:
        fault = str(error).splitlines()[-1].strip()
        text = f"no correction is proposed: moved, the data are invalid: {fault}"
        return _with(report, warnings=[*report.warnings, CheckWarning(code="shifted", message=text)])
    return _with(report, moved=groups, proposal=proposal)


def _same_outline(own: BoardType | None, board: BoardType) -> bool:
    """Return whether the outline is that of the run's board type, which placed the board."""
    if own is None or own.outline is None or board.outline is None:
        return False
    ours, theirs = (np.array(b.extent()) * b.mm_per_unit * (1, 1 if b.y_axis == "up" else -1) for b in (own, board))
    return bool(np.abs(np.sort(ours, axis=0) - np.sort(theirs, axis=0)).max() <= _SAME_OUTLINE_MM)


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(float(value), 4)


_MARGIN_MM = 4.0
_SIDE_PX = 1600
"""Length to which the longer side of the picture is enlarged, at most by 4."""
STATED, FOUND, ABSENT = (255, 160, 0), (0, 230, 255), (60, 60, 255)
"""Colours, BGR: bodies where the run's C puts them, where they were found, and those that seem to be absent."""
_MOST_LABELS = 300


def picture_of_check(run: CheckedRun, board: BoardType, report: BoardCheck) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3), BGR, of a checked board type, in the orientation of the tester's axes."""
    overview, stated = run.overview, run.stated_matrix(board)
    found = None if report.tester_from_cad is None else np.array(report.tester_from_cad)
    unlikely = {entry.ref for entry in report.unlikely}
    index = ComponentIndex.of(board)
    drawn = [
        (colour, apply(overview.px_from_tester @ matrix, index.corners.reshape(-1, 2)).reshape(-1, 4, 2))
        for colour, matrix in ((STATED, stated), (FOUND, found))
        if matrix is not None
    ]
    h, w = overview.grey.shape
    low, high = np.zeros(2), np.array([w, h], dtype=np.float64)
    if drawn:
        every, margin = drawn[-1][1].reshape(-1, 2), _MARGIN_MM * overview.px_per_mm
        low = np.clip(np.floor(every.min(0) - margin), 0, high - 2)
        high = np.clip(np.ceil(every.max(0) + margin), low + 2, high)
    (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
    factor = float(np.clip(_SIDE_PX / max(x1 - x0, y1 - y0), 1, 4))
    picture = cv2.cvtColor(np.ascontiguousarray(overview.grey[y0:y1, x0:x1]), cv2.COLOR_GRAY2BGR)
    picture = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    for colour, corners in drawn:
        for address, body in zip(index.addresses, corners, strict=True):
            absent = colour == FOUND and address in unlikely
            at = (body - low + 0.5) * factor - 0.5
            shade = ABSENT if absent else colour
            # OpenCV takes sixteenths of a pixel; far-off corners would overflow.
            points = np.rint(np.clip(at, -1e4, 1e5) * 16).astype(np.int32)
            cv2.polylines(picture, [points], True, shade, 2 if absent else 1, cv2.LINE_AA, 4)
            if colour == FOUND and (absent or len(index.addresses) <= _MOST_LABELS):
                x, y = np.rint(np.clip(at.min(0), -1e4, 1e5)).astype(int).tolist()
                cv2.putText(picture, address, (x, y - 2), cv2.FONT_HERSHEY_SIMPLEX, 0.35, shade, 1, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


@dataclass(frozen=True, eq=False)
class CheckedBoardType:
    """The result of a check."""

    report: BoardCheck
    """Residuals with standard deviations, components that do not look as if they were there, warnings."""
    picture: NDArray[np.uint8] = field(repr=False)
    """(h, w, 3), BGR: bodies where the run's C puts them (blue), where they are (yellow), and unlikely ones (red)."""

    @property
    def corrected(self) -> BoardType | None:
        """The corrected board type, a draft; None if there is nothing to correct."""
        return self.report.proposal


def checked_board_type(run: CheckedRun, board_type: BoardType) -> CheckedBoardType:
    """Lay a board type over a run."""
    report = check_board(run, board_type)
    return CheckedBoardType(report, picture_of_check(run, board_type, report))

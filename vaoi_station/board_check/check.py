"""Check a board type against a stitched run: the entrance of this room."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.board_check.body_edges import BodyEdges
from vaoi_station.board_check.correction import Group, Move, moved_board_type
from vaoi_station.board_check.fiducials import distances_of_marks
from vaoi_station.board_check.pose_search import Pose, find_poses, middle_of, refine_pose
from vaoi_station.board_check.presence import shares_weaker
from vaoi_station.board_check.report import BoardCheck, CheckedFiducial, CheckWarning, Residual, Unlikely
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane, expected_angle, typical_camera
from vaoi_station.stitching.components.centres import central_views, measure_component_shift
from vaoi_station.stitching.expectation import turned_by

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
    """Lay a board type over a run.

    Args:
        run: the run.
        board_type: the board type that is checked; the run may have been stitched with another one.

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
        return report.model_copy(update={"warnings": [CheckWarning(code="not-found", message=text)]})
    fit = _measured(run, plane, edges, best)
    c = fit.pose.matrix @ to_mm
    shares = shares_weaker(run.overview, edges, fit.pose.matrix)
    parts = board_type.components
    unlikely = [
        Unlikely(ref=parts[n].address, share=round(float(shares[n]), 2))
        for n in np.argsort(shares)
        if shares[n] < _UNLIKELY
    ]
    report = report.model_copy(
        update={
            "tester_from_cad": c.tolist(),
            "measured": fit.measured,
            "unlikely": unlikely,
            "not_filmed": [p.address for p, share in zip(parts, shares, strict=True) if math.isnan(share)],
        }
    )
    warnings = _about_components(report)
    if given is None:
        text = "the run has no CAD mapping, so residuals and a correction cannot be stated."
        warnings = [*_about_side(fit.pose.mirrored != plane.mirrored), *warnings]
        warnings.append(CheckWarning(code="no-cad-mapping", message=text))
        return report.model_copy(update={"warnings": warnings})
    move, residual = _residual(fit, edges, given, board_type)
    found = distances_of_marks(run, board_type, given), distances_of_marks(run, board_type, c)
    fiducials = [
        CheckedFiducial(name=f.name, off_mm=_rounded(stated), off_corrected_mm=_rounded(moved))
        for f, stated, moved in zip(board_type.fiducials, *found, strict=True)
    ]
    corrects = _about_residual(residual, fit.arm_mm)
    report = report.model_copy(
        update={
            "residual": residual,
            "fiducials": fiducials,
            "warnings": [*corrects, *_about_fiducials(fiducials), *warnings],
        }
    )
    return _with_proposal(report, run, board_type, move) if corrects else report


def _pose_at(poses: Sequence[Pose], edges: BodyEdges, stated: Floats) -> Pose | None:
    """Return the pose at which C of the run puts the bodies, if no other one fits clearly better; None otherwise.

    Args:
        poses: the poses, the best one first.
        edges: the bodies.
        stated: (3, 3) C from CAD data in mm.
    """
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
    upright = expected_angle(plane, typical_camera(run.cameras), turned_by(0))
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
        warning = CheckWarning(
            code="shifted", message=f"no correction is proposed: moved, the data are invalid: {fault}"
        )
        return report.model_copy(update={"warnings": [*report.warnings, warning]})
    return report.model_copy(update={"moved": groups, "proposal": proposal})


def _same_outline(own: BoardType | None, board: BoardType) -> bool:
    """Return whether the outline is that of the run's board type, which placed the board."""
    if own is None or own.outline is None or board.outline is None:
        return False
    ours, theirs = (np.array(b.extent()) * b.mm_per_unit * (1, 1 if b.y_axis == "up" else -1) for b in (own, board))
    return bool(np.abs(np.sort(ours, axis=0) - np.sort(theirs, axis=0)).max() <= _SAME_OUTLINE_MM)


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(float(value), 4)

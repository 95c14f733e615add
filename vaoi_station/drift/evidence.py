"""Collect what `equations` needs from a finished run: links on the bare board, fiducials and initial values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.stitching.adjustment.initial_motion import chain_links
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.adjustment.observations import Ints, Observations, to_observations
from vaoi_station.stitching.adjustment.problem import FiducialPoints, SurfaceBasis
from vaoi_station.stitching.adjustment.surface import SIGMA_MM, basis_at_board
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane
from vaoi_station.stitching.board.fiducial_assignment import assign_fiducials
from vaoi_station.stitching.board.footprints import component_at
from vaoi_station.stitching.matching.evidence import Detections, Evidence, Links

_LINKS_OF_ROWS = 24
"""Largest number of links that are used per pair of rows of one camera."""


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """The inputs of the second adjustment of a run, with k links and s fiducial detections.

    Link number n joins the pixel `a_px[n]` of camera `camera_a[n]` with the pixel `b_px[n]` of camera `camera_b[n]`.
    """

    cameras: tuple[Camera, ...]
    times_s: Floats
    links: Observations
    """Links on the bare board. If C is unknown, all links."""
    camera_a: Ints
    a_px: Floats
    """(k, 2) undistorted pixels."""
    camera_b: Ints
    b_px: Floats
    motion: Motion
    """Initial values of the rows' motion."""
    surface: SurfaceBasis
    """Basis functions of the board's height. If C is unknown, the only one is a constant."""
    fiducials: FiducialPoints | None
    camera_f: Ints
    f_px: Floats
    similarity: Floats | None
    nominal_scale: float


def prepare_evidence(
    cameras: tuple[Camera, ...],
    board_type: BoardType | None,
    times_s: Floats,
    velocity_mm_s: tuple[float, float],
    evidence: Sequence[Evidence],
    stitch: Stitch,
) -> RunEvidence:
    """Prepare the evidence of a run.

    Args:
        cameras: the cameras as calibrated.
        board_type: board type of the run; None if it is unknown.
        times_s: (m,) time of each of the m rows.
        velocity_mm_s: nominal velocity of the belt.
        evidence: evidence of the run's tasks, in any order.
        stitch: result of the run. Only C is read from it, if the result has one.
    """
    order = sorted(evidence, key=lambda e: (e.task.a, e.task.b or (-1, -1), e.task.kind))
    found = [e for e in order if isinstance(e, Links) and e.task.kind != "reference" and not e.unmatched]
    pivot = np.mean([c.row_from_image(c.center_px) for c in cameras], axis=0)
    seen = to_observations(found, cameras)
    motion = chain_links(nominal_motion(times_s, np.asarray(velocity_mm_s, dtype=np.float64), pivot), seen)
    plane = None if board_type is None or stitch.cad_matrix is None else board_plane(board_type, cameras[0])
    c = None if plane is None or stitch.cad_matrix is None else _similarity(stitch.cad_matrix)
    if plane is not None and c is not None:
        # A link on a component lies above the board. Across a seam, this height looks like a displacement of a camera.
        bare = component_at(plane, c, motion.board(seen.p, seen.a_mm)) < 0
        found, seen = _kept(found, bare), to_observations(_kept(found, bare), cameras)
    points, camera_f, f_px = _fiducials(plane, c, order, cameras, motion)
    return RunEvidence(
        cameras,
        times_s,
        seen,
        _spread([e.task.a[0] for e in seen.groups], seen.groups),
        _stacked([cameras[e.task.a[0]].lens.undistort(e.a_px) for e in seen.groups]),
        _spread([(e.task.b or e.task.a)[0] for e in seen.groups], seen.groups),
        _stacked([cameras[(e.task.b or e.task.a)[0]].lens.undistort(e.b_px) for e in seen.groups]),
        motion,
        _surface(plane, c, motion, seen, points),
        points,
        camera_f,
        f_px,
        c if points is not None else None,
        board_type.mm_per_unit if board_type else 1.0,
    )


def subsample_links(e: Evidence) -> Evidence:
    """Reduce the links of a pair of rows to an evenly spaced subset. Return other kinds of evidence unchanged."""
    # Links within one camera do not show its displacement. They determine the motion of the rows, and few are enough.
    if not isinstance(e, Links) or e.task.kind != "rows" or len(e.a_px) <= _LINKS_OF_ROWS:
        return e
    use = np.linspace(0, len(e.a_px) - 1, _LINKS_OF_ROWS).round().astype(np.int_)
    return replace(e, a_px=e.a_px[use], b_px=e.b_px[use], information=e.information[use], score=e.score[use])


def _kept(links: Sequence[Links], keep: np.ndarray) -> list[Links]:
    """Return the links, reduced to those point pairs that `keep` (k,) selects among all k pairs."""
    out, start = [], 0
    for e in links:
        use = keep[start : start + len(e.a_px)]
        start += len(e.a_px)
        out.append(replace(e, a_px=e.a_px[use], b_px=e.b_px[use], information=e.information[use], score=e.score[use]))
    return out


def _similarity(cad_matrix: Floats) -> Floats:
    """Extract the parameters (4,) a, b, x, y from the 3×3 matrix C of a result."""
    c = cad_matrix / cad_matrix[2, 2]
    return np.array([c[0, 0], c[1, 0], c[0, 2], c[1, 2]])


def _fiducials(
    plane: BoardPlane | None, c: Floats | None, evidence: Sequence[Evidence], cameras: Sequence[Camera], motion: Motion
) -> tuple[FiducialPoints | None, Ints, Floats]:
    """Select the detections that are fiducials under C; return their points, cameras and pixels, or None."""
    parts, camera, px = [], [], []
    for s in evidence:
        if plane is None or c is None or not isinstance(s, Detections) or not len(s.px):
            continue
        points = assign_fiducials(plane, c, [s], cameras, motion)
        if len(points.row):
            parts.append(points)
            camera.append(np.full(len(points.row), s.task.a[0]))
            seen_by = cameras[s.task.a[0]]
            px.append(seen_by.lens.undistort(_pixels_of(points, s, seen_by)))
    if not parts:
        return None, np.zeros(0, dtype=np.int_), np.zeros((0, 2))
    return FiducialPoints.joined(parts), np.concatenate(camera), np.concatenate(px)


def _pixels_of(points: FiducialPoints, s: Detections, camera: Camera) -> Floats:
    """Find the pixels of those detections `s` from which the fiducial points were made."""
    ground = camera.ground(s.px)
    off = np.hypot(*np.moveaxis(ground[None] - points.ground_mm[:, None], 2, 0))
    return np.asarray(s.px[off.argmin(1)])


def _surface(
    plane: BoardPlane | None, c: Floats | None, motion: Motion, links: Observations, points: FiducialPoints | None
) -> SurfaceBasis:
    marks = np.zeros((0, 2)) if points is None else motion.board(points.row, points.ground_mm)
    if plane is None or c is None:
        return SurfaceBasis(np.ones((len(links), 1)), np.ones((len(marks), 1)), SIGMA_MM[:1])
    on_board = motion.board(links.p, links.a_mm)
    at_links, at_marks = (basis_at_board(plane.board_type, plane.matrix(c), at) for at in (on_board, marks))
    return SurfaceBasis(at_links, at_marks, SIGMA_MM)


def _spread(values: Sequence[int], groups: Sequence[Links]) -> Ints:
    return np.repeat(np.array(values, dtype=np.int_), [len(e.a_px) for e in groups])


def _stacked(parts: Sequence[Floats]) -> Floats:
    return np.concatenate(parts) if parts else np.zeros((0, 2))

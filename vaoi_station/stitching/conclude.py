"""From evidence to a result: motion, CAD mapping, heights, verdict; reads from top to bottom.

The order is that of section 3.3: first the motion of the rows from links alone, then the board's
fiducials on it, then everything together in one adjustment.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station import __version__
from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.stitching.adjustment import Adjusted, FiducialPoints, Problem, SurfaceBasis, adjust
from vaoi_station.stitching.cad import Frame, Hypothesis, assign, board_frame, expected_angle, find_board, gather
from vaoi_station.stitching.evidence import Evidence, FrameKey, Links, Sightings
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.footprints import component_of, footprint_views
from vaoi_station.stitching.motion import Motion, nominal_motion
from vaoi_station.stitching.observations import Observations, observe
from vaoi_station.stitching.orientation import Orientation, check
from vaoi_station.stitching.sight import look_again
from vaoi_station.stitching.start import chained
from vaoi_station.stitching.surface import SIGMA_MM, basis_on_board, described
from vaoi_station.stitching.verdict import Findings, judge, quality_of

FrameSource = Callable[[int, int], NDArray[np.uint8] | None]


@dataclass
class Stages:
    """How long the stages took, in ms of wall time."""

    ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def done(self, name: str) -> None:
        """The stage of that name has just ended."""
        now = time.perf_counter()
        self.ms[name] = round((now - self._last) * 1e3, 3)
        self._last = now


def conclude(
    cameras: tuple[Camera, ...],
    board_type: BoardType | None,
    expectation: Expectation,
    velocity_mm_s: Floats,
    times_s: Floats,
    present: Collection[FrameKey],
    evidence: Sequence[Evidence],
    grey: FrameSource,
) -> Stitch:
    """Make the result of a run from the evidence of its frames.

    Args:
        cameras: the calibrated array.
        board_type: what is on the belt; None leaves C out.
        expectation: where the board should lie.
        velocity_mm_s: nominal velocity, (2,).
        times_s: (m,) time of every row.
        present: the good frames.
        evidence: of the canonical tasks, in any order.
        grey: 8-bit pixels of a frame, for a second look at fiducials.
    """
    stages = Stages()
    order = sorted(evidence, key=lambda e: (e.task.a, e.task.b or (-1, -1), e.task.kind))
    links = [e for e in order if isinstance(e, Links)]
    sightings = [e for e in order if isinstance(e, Sightings)]
    observed = observe(links, cameras)
    pivot = np.mean([c.row_from_image(c.center_px) for c in cameras], axis=0)
    nominal = nominal_motion(times_s, velocity_mm_s, pivot)
    problem = Problem(times_s, velocity_mm_s, observed, np.full(len(observed), -1))
    moved = adjust(problem, chained(nominal, observed))
    stages.done("motion")

    found: Adjusted | Failure
    frame = None
    which: list[int] = []
    if board_type is None:
        found = Failure("no board type was given, so there is no CAD mapping")
    else:
        frame = board_frame(board_type, cameras[0])
        found, problem, which = _map_cad(frame, cameras, expectation, problem, moved, sightings, present, grey)
    stages.done("cad")
    final = moved if isinstance(found, Failure) else found
    findings = Findings(
        frame=frame,
        cameras=cameras,
        present=frozenset(present),
        links=tuple(links),
        problem=problem,
        adjusted=final,
        cad_failure=found.reason if isinstance(found, Failure) else None,
        which=tuple(which),
    )
    status, reasons = judge(findings)
    quality = quality_of(findings) | {
        "timings_ms": stages.ms,
        "software": f"vaoi_station {__version__}",
        "opencv": cv2.__version__,
    }
    stages.done("verdict")
    return _result(findings, status, reasons, quality)


def _map_cad(
    frame: Frame,
    cameras: tuple[Camera, ...],
    expectation: Expectation,
    problem: Problem,
    moved: Adjusted,
    sightings: list[Sightings],
    present: Collection[FrameKey],
    grey: FrameSource,
) -> tuple[Adjusted | Failure, Problem, list[int]]:
    """Find the fiducials, look for them again where they must be, and adjust everything together."""
    angle = expected_angle(frame, cameras[0], expectation)
    places = gather(sightings, cameras, moved.motion)
    texture = _texture(problem.links, moved)
    guess = find_board(frame, places, angle, expectation, texture)
    if isinstance(guess, Failure):
        return guess, problem, []
    turned = find_board(frame, places, angle + np.pi, expectation, texture)
    if isinstance(turned, Hypothesis) and len(turned.fiducials) >= len(guess.fiducials):
        frames = sorted(present)
        seen_as = check(
            frame.board_type, frame.matrix(guess.c), frame.matrix(turned.c), cameras, moved.motion, frames, grey
        )
        if seen_as is not None and seen_as.contradicts:
            return _turned_round(frame, seen_as), problem, []
    seen = look_again(frame.board_type, frame.matrix(guess.c), cameras, moved.motion, sightings, grey)
    points, which = assign(frame, guess.c, seen, cameras, moved.motion)
    tall_view = all(camera.working_distance_mm is not None for camera in cameras)
    whole = _with_board(problem, points, frame, moved.motion, guess.c, tall_view=tall_view)
    return adjust(whole, moved.motion, guess.c), whole, which


def _turned_round(frame: Frame, seen_as: Orientation) -> Failure:
    contrast = f"{seen_as.turned:.0f} against {seen_as.as_placed:.0f} grey levels"
    return Failure(
        f"the board lies turned by 180°, or is of another type than {frame.board_type.name!r}: "
        f"by its {seen_as.evidence} the pictures fit the turned board (edge contrast {contrast})"
    )


def _with_board(
    problem: Problem, points: FiducialPoints, frame: Frame, motion: Motion, c: Floats, *, tall_view: bool
) -> Problem:
    """The problem with fiducials, the surface (where cameras know their height), and the component of every link."""
    on_board = motion.board(problem.links.p, problem.links.a_mm)
    marks = motion.board(points.row, points.ground_mm)
    at_links, at_marks = (basis_on_board(frame.board_type, frame.matrix(c), at) for at in (on_board, marks))
    return replace(
        problem,
        component=component_of(frame, c, on_board),
        fiducials=points,
        nominal_scale=frame.board_type.mm_per_unit,
        surface=SurfaceBasis(at_links, at_marks, SIGMA_MM) if tall_view else None,
    )


def _texture(links: Observations, moved: Adjusted) -> Floats:
    """Places on the board that were linked from row to row and move as the board does."""
    use = (moved.weight > 0.5) & (links.p != links.q)
    return moved.motion.board(links.p[use], links.a_mm[use])


def _result(findings: Findings, status: Any, reasons: tuple[str, ...], quality: dict[str, Any]) -> Stitch:
    motion = findings.adjusted.motion
    d = [motion.row_from_tester(j) for j in range(len(motion.angle))]
    c = findings.adjusted.similarity
    matrix = None if c is None or findings.frame is None or findings.cad_failure else findings.frame.matrix(c)
    components = surface = None
    if matrix is not None and findings.frame is not None:
        board_type = findings.frame.board_type
        if len(findings.adjusted.surface_mm):
            surface = described(board_type, findings.adjusted.surface_mm)
        components = footprint_views(board_type, matrix, findings.cameras, d, surface)
    return Stitch(
        method="auto",
        image_matrices=tuple(
            tuple(
                (camera.image_from_row.matrix @ row.matrix) if findings.placed[j] else None for j, row in enumerate(d)
            )
            for camera in findings.cameras
        ),
        cad_matrix=matrix,
        row_motion=tuple(row.matrix for row in d),
        status=status,
        reasons=reasons,
        quality=quality,
        surface=surface,
        components=components,
    )

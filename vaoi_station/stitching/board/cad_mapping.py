"""The CAD mapping of a run: find the fiducials among the detections, check the orientation, adjust all unknowns.

A first C is computed from the detections that were made during the run. It is accepted if the board's outline is
visible where this C puts it. Otherwise the frames are searched again for more marks before the mapping fails. At the
end, the shift of the outline against the adjusted C is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import ReasonCode
from vaoi_station.steps import Steps
from vaoi_station.stitching.adjustment.cameras import comparable_cameras
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import (
    SIGMA_MM,
    AdjustmentResult,
    FiducialPoints,
    Problem,
    SurfaceBasis,
    basis_at_board,
)
from vaoi_station.stitching.adjustment.row_motion import MovedRows, board_texture, motion_from_links
from vaoi_station.stitching.adjustment.solver import Unknowns, adjust, adjust_first_rows
from vaoi_station.stitching.board.board_plane import BoardPlane, component_at, expected_angle, typical_camera
from vaoi_station.stitching.board.fiducials import (
    Hypothesis,
    assign_fiducials,
    detect_more_marks,
    displaced_places,
    find_board,
    find_rough_places,
    merge_detections,
    relocate_fiducials,
)
from vaoi_station.stitching.board.outline import (
    MOST_BESIDE,
    LeftOut,
    OutlineContrast,
    OutlineShift,
    compare_orientations,
    link_depths_mm,
    links_on_board,
    measure_outline_contrast,
    measure_outline_shift,
    outline_confirmed,
    shares_beside,
    without_links_beside,
)
from vaoi_station.stitching.board.reference import (
    Reference,
    ReferenceScene,
    cad_points,
    compare_with_reference,
    disagreeing_reference,
    initial_similarity,
)
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Detections, Links, Method
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.matching.refinement import WINDOW_PX

_LEAST_REFERRED = 12
"""Least number of points linked to a reference that can place a board without fiducials."""
_LEAST_OWN_LINKS = 24
"""Least number of links on the board; with fewer, links beside the board are not left out."""
_SELECTIONS = 4
"""Largest number of times that links on the board are selected, each time with the motion and C of the last ones."""
_CERTAIN_FIDUCIALS = 3
"""Number of fiducials, if all are found, from which on a board is placed although its outline is not confirmed."""
_SAME_C_MM = 0.2
"""Largest distance of the board's corners by C of all rows from those by C of the first rows.

The first C from detections errs by some hundredths of a mm."""


class Turned(Failure):
    """The failure that the board lies turned by 180°, as the pictures show. No other evidence overrides it."""


@dataclass(frozen=True, eq=False)
class CadMapping:
    """The CAD mapping of a board that was found: the adjustment of all unknowns, and the checks of the outline."""

    adjusted: AdjustmentResult
    outline: OutlineContrast | None
    """Contrast along the outline where the first C puts it; None if too little of the outline is in view."""
    ambiguous: bool = False
    """Whether the board may equally well be turned by 180°, because neither fiducials nor pictures decide."""
    shift: OutlineShift | None = None
    """Measured shift of the outline against the adjusted C; None if too little of the outline shows an edge."""
    moved: MovedRows | None = None
    """The motion of the rows from links on the board alone; None if no links beside the board were left out."""
    left_out: LeftOut | None = None

    @property
    def problem(self) -> Problem:
        """The problem of the adjustment, with the displacements of the cameras applied to links and points."""
        return self.adjusted.problem


@dataclass(frozen=True, eq=False)
class MappingInputs:
    """The evidence and the prior knowledge from which a CAD mapping is computed."""

    expectation: Expectation
    method: Method
    detections: tuple[Detections, ...]
    texture_mm: Floats
    """(k, 2) points on the board, mm, that were linked from row to row."""
    reference: Reference | None = None
    reference_links: tuple[Links, ...] = ()
    taught: ReferenceScene | None = None
    first_rows: Callable[[], Unknowns | None] | None = None
    """A function that returns what `map_first_rows` has found for all rows but the last one."""


class _FirstC(NamedTuple):
    guess: Hypothesis | Failure
    detections: tuple[Detections, ...]
    outline: OutlineContrast | None


class _OwnTexture(NamedTuple):
    """A run without the links beside the board: its problem, the solution, and the first C found with it."""

    problem: Problem
    moved: MovedRows
    first: _FirstC
    left_out: LeftOut

    @property
    def fits(self) -> int:
        return len(self.first.guess.fiducials) if isinstance(self.first.guess, Hypothesis) else 0

    @property
    def cost(self) -> float:
        return self.first.guess.cost if isinstance(self.first.guess, Hypothesis) else np.inf


def map_cad(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: MovedRows, known: MappingInputs
) -> CadMapping | Failure:
    """Find the board, locate its fiducials again where a first C predicts them, and adjust all unknowns together."""
    referred, board_type = FiducialPoints.empty(), plane.board_type
    if known.reference is not None and known.method.reference:
        referred = cad_points(known.reference_links, scene.cameras, plane, known.reference)
    first = _find_first_c(plane, scene, moved, known, referred)
    depth_mm = np.zeros(0)
    if isinstance(first.guess, Hypothesis):
        depth_mm = link_depths_mm(plane, first.guess.c, problem.links, moved.motion)
    apart = _apart_from_surroundings(plane, scene, problem, moved, known, first, depth_mm)
    if apart is not None:
        problem, moved, first = apart[:3]
    guess, motion = first.guess, moved.motion
    if isinstance(guess, Failure):
        return guess
    if apart is None:
        problem = _without_some_beside(plane, scene, problem, motion, guess.c, depth_mm)
    marks = _located(plane, scene, motion, guess.c, first.detections)
    # Boards of a panel lie differently in every panel, so that a reference shows no C where fiducials do.
    fiducials = len(set(marks.which[marks.which >= 0].tolist()))
    alone = bool(board_type.board_fiducials) and max(fiducials, marks.fixture_marks) >= 2
    points = marks if alone else FiducialPoints.joined([marks, referred])
    before = known.first_rows() if known.first_rows is not None and apart is None else None
    if before is not None and not _same_place(plane, before.similarity, guess.c):
        before = None
    whole = _with_board(problem, points, plane, scene, motion, guess.c, before.problem if before is not None else None)
    adjusted = adjust(whole, motion, guess.c, known=before)
    if contradiction := disagreeing_reference(points, adjusted.fiducial_px):
        return contradiction
    # The outline is measured with the displaced cameras, as everything after the adjustment is.
    corrected = replace(scene, cameras=adjusted.problem.cameras) if adjusted.cameras is not None else scene
    c, shift = adjusted.similarity, None
    if c is not None:
        shift = measure_outline_shift(board_type, plane.matrix(c), corrected, adjusted.motion)
    own = (None, None) if apart is None else (moved, apart.left_out)
    return CadMapping(adjusted, first.outline, guess.ambiguous, shift, *own)


def map_first_rows(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: MovedRows, known: MappingInputs
) -> Steps[Unknowns | None]:
    """Adjust all unknowns of a run of which a row is still to come; None if its detections do not show the board yet.

    `map_cad` goes on from it if its own C, which the pictures have confirmed, is the same.
    """
    guess = _from_marks(plane, scene, moved, known)[0]
    yield
    if isinstance(guess, Failure):
        return None
    points = _located(plane, scene, moved.motion, guess.c, known.detections)
    yield
    depth_mm = link_depths_mm(plane, guess.c, problem.links, moved.motion)
    problem = _without_some_beside(plane, scene, problem, moved.motion, guess.c, depth_mm)
    yield
    whole = _with_board(problem, points, plane, scene, moved.motion, guess.c)
    yield
    return (yield from adjust_first_rows(whole, moved.motion, guess.c))


def _without_some_beside(
    plane: BoardPlane, scene: Scene, problem: Problem, motion: Motion, c: Floats, depth_mm: Floats
) -> Problem:
    return without_links_beside(problem, depth_mm, partial(outline_confirmed, plane, plane.matrix(c), scene, motion))


def _located(
    plane: BoardPlane, scene: Scene, motion: Motion, c: Floats, detections: tuple[Detections, ...]
) -> FiducialPoints:
    """Locate the fiducials precisely where a first C puts them."""
    board_type, places = plane.board_type, apply(plane.matrix(c), plane.cad(plane.fiducials))
    if board_type.board_fiducials:
        found = merge_detections(detections, scene.cameras, motion)
        places = displaced_places(board_type, places, found.mm, found.kind)
    seen = relocate_fiducials(board_type, places, scene, motion, detections)
    return assign_fiducials(plane, c, seen, scene.cameras, motion, places)


def _same_place(plane: BoardPlane, a: Floats, b: Floats) -> bool:
    corners = plane.board_type.extent()
    return bool(np.abs(apply(plane.matrix(a), corners) - apply(plane.matrix(b), corners)).max() <= _SAME_C_MM)


def _apart_from_surroundings(
    plane: BoardPlane,
    scene: Scene,
    problem: Problem,
    moved: MovedRows,
    known: MappingInputs,
    first: _FirstC,
    depth_mm: Floats,
) -> _OwnTexture | None:
    """Leave out the links beside the board if they are many, or if no board is found with them; None to keep all.

    `depth_mm` are the `link_depths_mm` at the first C, if there is one.

    A carrier, or a belt with texture, may move with the board or stand still, at the board's height or below it. Every
    position of the board that the detections allow is tried, and the pictures must confirm its outline.
    """
    guess, known = first.guess, replace(known, detections=first.detections)
    if not known.method.links or isinstance(guess, Turned) or plane.board_type.outline is None:
        return None
    rough, of_rows = [], 1.0
    if isinstance(guess, Hypothesis):
        of_rows, of_seams = shares_beside(depth_mm, problem.links)
        if max(of_rows, of_seams) <= MOST_BESIDE:
            return None
        rough.append(guess)
    if known.method.marks:
        angle = expected_angle(plane, typical_camera(scene.cameras), known.expectation)
        seen = merge_detections(first.detections, scene.cameras, moved.motion)
        rough += find_rough_places(plane, seen, angle, known.expectation)
    tried = [_without_surroundings(plane, scene, problem, moved, known, place.c) for place in rough]
    found = [one for one in tried if one is not None]
    confirmed = [one for one in found if one.left_out.confirmed]
    if not confirmed and isinstance(guess, Hypothesis):
        # Links beside the board that occur only between cameras do not make the position doubtful.
        return tried[0] if of_rows > MOST_BESIDE else None
    if not confirmed:
        confirmed = [one for one in found if one.fits >= max(len(plane.fiducials), _CERTAIN_FIDUCIALS)]
    if confirmed or not found or not isinstance(guess, Failure):
        return min(confirmed, key=lambda one: one.cost, default=None)
    best = min(found, key=lambda one: one.cost)
    if best.left_out.share <= MOST_BESIDE:
        return None
    text = (
        f"{guess.reason}. Without the {best.left_out.share:.0%} of the texture that would lie beside the board, "
        f"{best.fits} of them fit, but the edges of the board do not show there: a carrier or a belt with texture "
        "must be brighter or darker than the board's edge, and a third fiducial places the board in spite of it"
    )
    return best._replace(first=_FirstC(Failure(text, guess.code), first.detections, None))


def _without_surroundings(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: MovedRows, known: MappingInputs, c: Floats
) -> _OwnTexture | None:
    """Estimate the motion from the links on a board at position `c`, and find C with it; None if no C is found.

    Both are repeated until they agree with the links that were selected: with the motion of a belt, links beside the
    board are taken for its own. If two selections lead to each other, only the links that both contain are used.
    """
    coarsest = min(camera.px_per_mm for camera in scene.cameras)
    share = shares_beside(link_depths_mm(plane, c, problem.links, moved.motion), problem.links)[0]
    motion, agreed, earlier = moved, True, list[NDArray[np.int_]]()
    while agreed:
        chosen = links_on_board(plane, c, problem.links, motion.motion, coarsest)
        if earlier and np.array_equal(chosen, earlier[-1]):
            break
        agreed = len(earlier) + 1 < _SELECTIONS and not any(np.array_equal(chosen, other) for other in earlier)
        if not agreed:
            chosen = np.intersect1d(chosen, earlier[-1])
        if len(chosen) < _LEAST_OWN_LINKS:
            return None
        own = problem.select(chosen)
        earlier.append(chosen)
        motion = motion_from_links(own, motion.motion)
        found = _c_from_detections(plane, scene, motion, replace(known, texture_mm=board_texture(own.links, motion)))
        if isinstance(found, Failure):
            return None
        guess, c = found, found.c
    outline = _outline(plane, scene, motion, guess)
    visible = outline is not None and outline.visible
    confirmed = visible and outline_confirmed(plane, plane.matrix(guess.c), scene, motion.motion)
    others = problem.links.select(np.setdiff1d(np.arange(len(problem.links)), earlier[-1]))
    return _OwnTexture(own, motion, _FirstC(guess, known.detections, outline), LeftOut(share, confirmed, others))


def _find_first_c(
    plane: BoardPlane, scene: Scene, moved: MovedRows, known: MappingInputs, referred: FiducialPoints
) -> _FirstC:
    guess, detections = _c_from_detections(plane, scene, moved, known), known.detections
    outline = _outline(plane, scene, moved, guess)
    if isinstance(guess, Turned):
        return _FirstC(guess, detections, outline)
    # Marks that resemble a fiducial may have displaced the fiducials from a frame's short list of detections. A longer
    # list may contain them.
    if known.method.marks and (isinstance(guess, Failure) or (outline is not None and not outline.visible)):
        deep = tuple(detect_more_marks(plane.board_type, scene, detections, fixture=known.method.fixture))
        second = _c_from_detections(plane, scene, moved, replace(known, detections=deep))
        if isinstance(second, Hypothesis) or isinstance(guess, Failure):
            guess, detections, outline = second, deep, _outline(plane, scene, moved, second)
    # The reference run comes last: fiducials on the board itself are more reliable than a position from another run.
    lost = isinstance(guess, Failure) and not isinstance(guess, Turned)
    if lost and known.reference is not None and len(referred.row) >= _LEAST_REFERRED:
        guess = Hypothesis(initial_similarity(plane, known.reference, referred, moved.motion), 0.0, ())
        outline = _outline(plane, scene, moved, guess)
    return _FirstC(guess, detections, outline)


def _outline(plane: BoardPlane, scene: Scene, moved: MovedRows, guess: Hypothesis | Failure) -> OutlineContrast | None:
    if isinstance(guess, Failure):
        return None
    return measure_outline_contrast(plane.board_type, plane.matrix(guess.c), scene, moved.motion)


def _c_from_detections(plane: BoardPlane, scene: Scene, moved: MovedRows, known: MappingInputs) -> Hypothesis | Failure:
    """Find C from the detections; fail if the pictures show that the board is turned by 180°."""
    if not known.method.marks:
        return Failure("no point of the run was found again in the reference", ReasonCode.REFERENCE_NOT_FOUND)
    guess, turned = _from_marks(plane, scene, moved, known)
    if isinstance(guess, Failure) or isinstance(turned, Failure) or len(turned.fiducials) < len(guess.fiducials):
        return guess
    return _decided(plane, scene, moved.motion, known.taught, guess, turned)


def _from_marks(
    plane: BoardPlane, scene: Scene, moved: MovedRows, known: MappingInputs
) -> tuple[Hypothesis | Failure, Hypothesis | Failure]:
    """Find C from the detections, and that of the board turned by 180°, which may fit them as well."""
    angle = expected_angle(plane, typical_camera(scene.cameras), known.expectation)
    places = merge_detections(known.detections, scene.cameras, moved.motion)
    guess = find_board(plane, places, angle, known.expectation, known.texture_mm)
    if isinstance(guess, Failure):
        return guess, guess
    return guess, find_board(plane, places, angle + np.pi, known.expectation, known.texture_mm)


def _decided(
    plane: BoardPlane,
    scene: Scene,
    motion: Motion,
    taught: ReferenceScene | None,
    guess: Hypothesis,
    turned: Hypothesis,
) -> Hypothesis | Failure:
    """Decide between C and that of the turned board, which fits at least as many fiducials.

    Outline and components decide, else the frames of the reference, else the number of fiducials. If that is equal, C
    is kept and marked as ambiguous.
    """
    board_type = plane.board_type
    is_turned = f"the board lies turned by 180°, or is of another type than {board_type.name!r}: "
    rivals = plane.matrix(guess.c), plane.matrix(turned.c)
    edges = compare_orientations(board_type, *rivals, scene, motion)
    if edges is not None and edges.contradicts:
        contrast = f"{edges.turned:.0f} against {edges.as_placed:.0f} grey levels"
        shown = f"by its {edges.evidence} the pictures fit the turned board (edge contrast {contrast})"
        return Turned(is_turned + shown, ReasonCode.BOARD_TURNED)
    if edges is not None and edges.confirms:
        return guess
    if taught is not None:
        found = compare_with_reference(board_type, *rivals, scene, motion, taught)
        if found.contradicts:
            shown = (
                f"its pictures match the reference only when turned (correlation {found.turned:.2f} against "
                f"{found.as_placed:.2f} at {found.patches} places)"
            )
            return Turned(is_turned + shown, ReasonCode.BOARD_TURNED)
        if found.confirms:
            return guess
    fit, fit_turned = len(guess.fiducials), len(turned.fiducials)
    if fit_turned > fit:
        shown = f"{fit_turned} of its fiducials fit the turned board, {fit} the board as expected"
        return Failure(is_turned + shown, ReasonCode.BOARD_TURNED)
    return replace(guess, ambiguous=True)


def _with_board(
    problem: Problem,
    points: FiducialPoints,
    plane: BoardPlane,
    scene: Scene,
    motion: Motion,
    c: Floats,
    known: Problem | None = None,
) -> Problem:
    """Extend the problem by fiducial points, the component under each link, the board's surface, and the cameras.

    `known` is the extended problem of the first rows, if there is one: where their links lie is not computed again.
    """
    links, matrix = problem.links, plane.matrix(c)
    known = known if known is not None and problem.begins_with(known) else None
    count = len(known.links) if known is not None else 0
    on_board = motion.board(links.p[count:], links.a_mm[count:])
    marks = motion.board(points.row, points.ground_mm)
    at_links, at_marks = (basis_at_board(plane.board_type, matrix, at) for at in (on_board, marks))
    # Without a working distance, a height does not move a point, and the normal equations would be singular.
    knows_height = all(camera.working_distance_mm is not None for camera in scene.cameras)
    half_patch_mm = WINDOW_PX / 2 / float(np.mean([camera.px_per_mm for camera in scene.cameras]))
    near = component_at(plane, c, on_board, half_patch_mm)
    # What lies on a component is also near one.
    component, reached = np.full(len(near), -1), np.flatnonzero(near >= 0)
    component[reached] = component_at(plane, c, on_board.take(reached, axis=0))
    if known is not None:
        component, near = (np.concatenate(of) for of in ((known.component, component), (known.near, near)))
        if known.surface is not None:
            at_links = np.concatenate([known.surface.at_links, at_links])
    return replace(
        problem,
        component=component,
        near=near,
        fiducials=points,
        nominal_scale=plane.board_type.mm_per_unit,
        surface=SurfaceBasis(at_links, at_marks, SIGMA_MM) if knows_height else None,
        cameras=comparable_cameras(scene.cameras),
    )

"""The CAD mapping of a run: find the fiducials among the detections, check the orientation, adjust all unknowns.

A first C is computed from the detections that were made during the run. It is accepted if the board's outline is
visible where this C puts it. Otherwise the frames are searched again for more marks before the mapping fails. At the
end, the shift of the outline against the adjusted C is measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import ReasonCode
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
from vaoi_station.stitching.adjustment.row_motion import board_texture, motion_from_links
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.board.board_plane import (
    BoardPlane,
    component_at,
    expected_angle,
    near_component,
    typical_camera,
)
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
    Orientation,
    OutlineContrast,
    OutlineShift,
    compare_orientations,
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
    Rivals,
    cad_points,
    compare_with_reference,
    disagreeing_reference,
    initial_similarity,
)
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Detections, Links, Method
from vaoi_station.stitching.matching.frames import Scene

_LEAST_REFERRED = 12
"""Least number of points linked to a reference that can place a board without fiducials."""
_LEAST_OWN_LINKS = 24
"""Least number of links on the board; with fewer, links beside the board are not left out."""
_SELECTIONS = 4
"""Largest number of times that links on the board are selected, each time with the motion and C of the last ones."""
_CERTAIN_FIDUCIALS = 3
"""Number of fiducials from which on a board is placed although its outline is not confirmed.

In addition, all fiducials of the board type must be found."""


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
    moved: AdjustmentResult | None = None
    """The motion of the rows from links on the board alone; None if no links beside the board were left out."""
    left_out: LeftOut | None = None
    """The links beside the board that were left out; None if none were."""

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
    """Result and frames of the reference; None if its frames cannot be read."""


def map_cad(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: AdjustmentResult, known: MappingInputs
) -> CadMapping | Failure:
    """Find the board, locate its fiducials again where a first C predicts them, and adjust all unknowns together.

    Args:
        moved: solution of that problem, whose motion of the rows is used.
    """
    referred = FiducialPoints.empty()
    if known.reference is not None and known.method.reference:
        referred = cad_points(known.reference_links, scene.cameras, plane, known.reference)
    first = _find_first_c(plane, scene, moved, known, referred)
    apart = _apart_from_surroundings(plane, scene, problem, moved, known, first)
    if apart is not None:
        problem, moved, first = apart[:3]
    guess, detections, outline = first
    if isinstance(guess, Failure):
        return guess
    if apart is None:
        confirmed = partial(outline_confirmed, plane, plane.matrix(guess.c), scene, moved.motion)
        problem = without_links_beside(plane, problem, moved.motion, guess.c, confirmed)
    places = apply(plane.matrix(guess.c), plane.cad(plane.fiducials))
    if plane.board_type.board_fiducials:
        found = merge_detections(detections, scene.cameras, moved.motion)
        places = displaced_places(plane.board_type, places, found.mm, found.kind)
    seen = relocate_fiducials(plane.board_type, places, scene, moved.motion, detections)
    marks = assign_fiducials(plane, guess.c, seen, scene.cameras, moved.motion, places)
    # Boards of a panel lie differently in every panel, so that a reference shows no C where fiducials do.
    fiducials = len(set(marks.which[marks.which >= 0].tolist()))
    alone = bool(plane.board_type.board_fiducials) and max(fiducials, marks.fixture_marks) >= 2
    points = marks if alone else FiducialPoints.joined([marks, referred])
    whole = _with_board(problem, points, plane, scene, moved.motion, guess.c)
    adjusted = adjust(whole, moved.motion, guess.c)
    if contradiction := disagreeing_reference(points, adjusted.fiducial_px):
        return contradiction
    # The outline is measured with the displaced cameras, as everything after the adjustment is.
    corrected = replace(scene, cameras=adjusted.problem.cameras) if adjusted.cameras is not None else scene
    shift = _measured_shift(plane, corrected, adjusted)
    mapping = CadMapping(adjusted, outline, guess.ambiguous, shift)
    return mapping if apart is None else replace(mapping, moved=moved, left_out=apart.left_out)


_FirstC = tuple[Hypothesis | Failure, tuple[Detections, ...], OutlineContrast | None]
"""A first C, the detections among which it was found, and the contrast of the outline."""


class _OwnTexture(NamedTuple):
    """A run without the links beside the board: its problem, the solution, and the first C found with it."""

    problem: Problem
    moved: AdjustmentResult
    first: _FirstC
    left_out: LeftOut


def _apart_from_surroundings(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: AdjustmentResult, known: MappingInputs, first: _FirstC
) -> _OwnTexture | None:
    """Leave out the links beside the board if they are many, or if no board is found with them.

    A carrier, or a belt with texture, may move with the board or stand still, at the board's height or below it. Every
    position of the board that the detections allow is tried. For each, the motion is estimated again from the links
    inside the outline, and a C is searched with this motion. The position is accepted if a C is found and the pictures
    confirm the outline. If no position is confirmed, the first C is kept. If there is no first C, a position is
    accepted at which all fiducials, at least three, are found; the verdict reports that the outline does not confirm
    it.

    Returns:
        The run without the links beside the board; None if all links are kept.
    """
    guess, known = first[0], replace(known, detections=first[1])
    if not known.method.links or isinstance(guess, Turned) or plane.board_type.outline is None:
        return None
    rough, of_rows = [], 1.0
    if isinstance(guess, Hypothesis):
        of_rows, of_seams = shares_beside(plane, guess.c, problem.links, moved.motion)
        if max(of_rows, of_seams) <= MOST_BESIDE:
            return None
        rough.append(guess)
    if known.method.marks:
        angle = expected_angle(plane, typical_camera(scene.cameras), known.expectation)
        seen = merge_detections(first[1], scene.cameras, moved.motion)
        rough += find_rough_places(plane, seen, angle, known.expectation)
    tried = [_without_surroundings(plane, scene, problem, moved, known, place.c) for place in rough]
    found = [one for one in tried if one is not None]
    confirmed = [one for one in found if one.left_out.confirmed]
    if not confirmed and isinstance(guess, Hypothesis):
        # Links beside the board that occur only between cameras do not make the position doubtful.
        return tried[0] if of_rows > MOST_BESIDE else None
    if not confirmed:
        every = len(plane.fiducials)
        confirmed = [one for one in found if _fits(one) >= max(every, _CERTAIN_FIDUCIALS)]
    if not confirmed and found:
        return _unconfirmed(min(found, key=_cost), guess)
    return min(confirmed, key=_cost, default=None)


def _unconfirmed(one: _OwnTexture, failure: Hypothesis | Failure) -> _OwnTexture | None:
    """Return the run with a failure in place of C; the failure names the texture beside the board as its cause."""
    if not isinstance(failure, Failure) or one.left_out.share <= MOST_BESIDE:
        return None
    text = (
        f"{failure.reason}. Without the {one.left_out.share:.0%} of the texture that would lie beside the board, "
        f"{_fits(one)} of them fit, but the edges of the board do not show there: a carrier or a belt with texture "
        "must be brighter or darker than the board's edge, and a third fiducial places the board in spite of it"
    )
    return one._replace(first=(Failure(text, failure.code), one.first[1], None))


def _cost(one: _OwnTexture) -> float:
    return one.first[0].cost if isinstance(one.first[0], Hypothesis) else np.inf


def _fits(one: _OwnTexture) -> int:
    return len(one.first[0].fiducials) if isinstance(one.first[0], Hypothesis) else 0


def _without_surroundings(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: AdjustmentResult, known: MappingInputs, c: Floats
) -> _OwnTexture | None:
    """Estimate the motion from the links on a board at position `c`, and find C with it; None if no C is found.

    Both are repeated until they agree with the links that were selected: with the motion of a belt, a position in a
    later row is taken for that in the first one, and links beside the board for its own. If two selections lead to each
    other, only the links that both contain are used: a row that is linked by its surroundings alone has no place.
    """
    coarsest = min(camera.px_per_mm for camera in scene.cameras)
    share = shares_beside(plane, c, problem.links, moved.motion)[0]
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
    outline = _measured_outline(plane, scene, motion.motion, guess)
    confirmed = (
        outline is not None
        and outline.visible
        and outline_confirmed(plane, plane.matrix(guess.c), scene, motion.motion)
    )
    others = problem.links.select(np.setdiff1d(np.arange(len(problem.links)), earlier[-1]))
    return _OwnTexture(own, motion, (guess, known.detections, outline), LeftOut(share, confirmed, others))


def _find_first_c(
    plane: BoardPlane, scene: Scene, moved: AdjustmentResult, known: MappingInputs, referred: FiducialPoints
) -> tuple[Hypothesis | Failure, tuple[Detections, ...], OutlineContrast | None]:
    """Find a first C; return it with the detections it was found among, and with the contrast of the outline."""
    guess, detections = _c_from_detections(plane, scene, moved, known), known.detections
    outline = _measured_outline(plane, scene, moved.motion, guess)
    # Marks that resemble a fiducial may have displaced the fiducials from a frame's short list of detections. A longer
    # list may contain them.
    if isinstance(guess, Turned):
        return guess, detections, outline
    if known.method.marks and (isinstance(guess, Failure) or (outline is not None and not outline.visible)):
        deep = tuple(detect_more_marks(plane.board_type, scene, detections, fixture=known.method.fixture))
        second = _c_from_detections(plane, scene, moved, replace(known, detections=deep))
        if isinstance(second, Hypothesis) or isinstance(guess, Failure):
            guess, detections, outline = second, deep, _measured_outline(plane, scene, moved.motion, second)
    # The reference run comes last: fiducials on the board itself are more reliable than a position from another run.
    lost = isinstance(guess, Failure) and not isinstance(guess, Turned)
    if lost and known.reference is not None and len(referred.row) >= _LEAST_REFERRED:
        guess = Hypothesis(initial_similarity(plane, known.reference, referred, moved.motion), 0.0, ())
        outline = _measured_outline(plane, scene, moved.motion, guess)
    return guess, detections, outline


def _c_from_detections(
    plane: BoardPlane, scene: Scene, moved: AdjustmentResult, known: MappingInputs
) -> Hypothesis | Failure:
    """Find C from the detections; fail if the pictures show that the board is turned by 180°."""
    if not known.method.marks:
        return Failure("no point of the run was found again in the reference", ReasonCode.REFERENCE_NOT_FOUND)
    expectation, detections = known.expectation, known.detections
    angle = expected_angle(plane, typical_camera(scene.cameras), expectation)
    places = merge_detections(detections, scene.cameras, moved.motion)
    texture = known.texture_mm
    guess = find_board(plane, places, angle, expectation, texture)
    if isinstance(guess, Failure):
        return guess
    # The turned board is a rival only if it fits at least as many fiducials. The pictures then decide.
    turned = find_board(plane, places, angle + np.pi, expectation, texture)
    if isinstance(turned, Hypothesis) and len(turned.fiducials) >= len(guess.fiducials):
        orientation = compare_orientations(
            plane.board_type, plane.matrix(guess.c), plane.matrix(turned.c), scene, moved.motion
        )
        if orientation is not None and orientation.contradicts:
            return _turned_failure(plane, orientation)
        if orientation is None or not orientation.confirms:
            return _by_reference(plane, scene, moved.motion, known, guess, turned)
    return guess


def _by_reference(
    plane: BoardPlane, scene: Scene, motion: Motion, known: MappingInputs, guess: Hypothesis, turned: Hypothesis
) -> Hypothesis | Failure:
    """Decide the orientation by the reference's frames; if these leave it open, by the number of fiducials that fit."""
    if known.taught is not None:
        rivals = Rivals(plane.matrix(guess.c), plane.matrix(turned.c))
        found = compare_with_reference(plane.board_type, rivals, scene, motion, known.taught)
        if found.contradicts:
            return Turned(
                f"the board lies turned by 180°, or is of another type than {plane.board_type.name!r}: its pictures "
                f"match the reference only when turned (correlation {found.turned:.2f} against {found.as_placed:.2f} "
                f"at {found.patches} places)",
                ReasonCode.BOARD_TURNED,
            )
        if found.confirms:
            return guess
    return _by_fiducial_count(plane, guess, turned)


def _by_fiducial_count(plane: BoardPlane, guess: Hypothesis, turned: Hypothesis) -> Hypothesis | Failure:
    """Decide the orientation by the number of fiducials that fit, where the pictures do not decide it.

    If more fiducials fit the turned board, the mapping fails. If the numbers are equal, C is kept and marked as
    ambiguous.
    """
    fit, fit_turned = len(guess.fiducials), len(turned.fiducials)
    if fit_turned > fit:
        return Failure(
            f"the board lies turned by 180°, or is of another type than {plane.board_type.name!r}: "
            f"{fit_turned} of its fiducials fit the turned board, {fit} the board as expected",
            ReasonCode.BOARD_TURNED,
        )
    return replace(guess, ambiguous=True)


def _measured_outline(
    plane: BoardPlane, scene: Scene, motion: Motion, guess: Hypothesis | Failure
) -> OutlineContrast | None:
    if isinstance(guess, Failure):
        return None
    return measure_outline_contrast(plane.board_type, plane.matrix(guess.c), scene, motion)


def _measured_shift(plane: BoardPlane, scene: Scene, adjusted: AdjustmentResult) -> OutlineShift | None:
    if adjusted.similarity is None:
        return None
    return measure_outline_shift(plane.board_type, plane.matrix(adjusted.similarity), scene, adjusted.motion)


def _turned_failure(plane: BoardPlane, orientation: Orientation) -> Turned:
    contrast = f"{orientation.turned:.0f} against {orientation.as_placed:.0f} grey levels"
    return Turned(
        f"the board lies turned by 180°, or is of another type than {plane.board_type.name!r}: "
        f"by its {orientation.evidence} the pictures fit the turned board (edge contrast {contrast})",
        ReasonCode.BOARD_TURNED,
    )


def _with_board(
    problem: Problem, points: FiducialPoints, plane: BoardPlane, scene: Scene, motion: Motion, c: Floats
) -> Problem:
    """Extend the problem by the fiducial points, the component under each link, the board's surface, and the cameras.

    The surface is added only if the working distances of all cameras are known.
    """
    on_board = motion.board(problem.links.p, problem.links.a_mm)
    marks = motion.board(points.row, points.ground_mm)
    at_links, at_marks = (basis_at_board(plane.board_type, plane.matrix(c), at) for at in (on_board, marks))
    # Without a working distance, a height does not move a point, and the normal equations would be singular.
    knows_height = all(camera.working_distance_mm is not None for camera in scene.cameras)
    return replace(
        problem,
        component=component_at(plane, c, on_board),
        near=near_component(plane, c, on_board, scene),
        fiducials=points,
        nominal_scale=plane.board_type.mm_per_unit,
        surface=SurfaceBasis(at_links, at_marks, SIGMA_MM) if knows_height else None,
        cameras=comparable_cameras(scene.cameras),
    )

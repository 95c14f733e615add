"""The CAD mapping of a run: which sightings are the fiducials, does the board really lie so, then one adjustment.

A first answer comes from the marks seen while filming. It is believed when the pictures do not
contradict it: the board's outline must be where the fiducials put it. Otherwise the frames are
searched once more, deeply, before the mapping is given up. In the end the outline is measured against it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints, Problem, SurfaceBasis
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.adjustment.surface import SIGMA_MM, basis_at_board
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.fiducial_assignment import (
    Frame,
    Hypothesis,
    assign,
    expected_angle,
    find_board,
    gather,
)
from vaoi_station.stitching.board.fiducial_detection import look_again, look_deeper
from vaoi_station.stitching.board.footprints import component_of
from vaoi_station.stitching.board.orientation import Orientation, Outline, check, outline_of
from vaoi_station.stitching.board.outline import Shift, outline_shift
from vaoi_station.stitching.board.reference import Reference, first_similarity, points_on_cad
from vaoi_station.stitching.matching.evidence import Detections, Links
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import Method

_LEAST_REFERRED = 12
"""Points linked to a reference before it may place a board by itself."""


@dataclass(frozen=True, eq=False)
class Mapping:
    """The board found: the whole adjustment, its problem, and what supports it."""

    adjusted: AdjustmentResult
    problem: Problem
    outline: Outline | None
    """Contrast along the board's outline as placed; None where no frame shows it."""
    either_way: bool = False
    """The board might lie turned by 180° as well: neither fiducials nor pictures tell."""
    shift: Shift | None = None
    """Of the board's outline against the adjusted fiducials; None where too little of it shows an edge."""


@dataclass(frozen=True, eq=False)
class Known:
    """What a mapping may rest on."""

    expectation: Expectation
    method: Method
    detections: tuple[Detections, ...]
    texture_mm: Floats
    """(k, 2) places on the board that were linked from row to row."""
    reference: Reference | None = None
    reference_links: tuple[Links, ...] = ()


def map_cad(frame: Frame, scene: Scene, problem: Problem, moved: AdjustmentResult, known: Known) -> Mapping | Failure:
    """Find the board, look for its marks again where they must be, and adjust everything together."""
    referred = FiducialPoints.empty()
    if known.reference is not None and known.method.reference:
        referred = points_on_cad(known.reference_links, scene.cameras, frame, known.reference)
    guess, detections, outline = _guess(frame, scene, moved, known, referred)
    if isinstance(guess, Failure):
        return guess
    seen = look_again(frame.board_type, frame.matrix(guess.c), scene, moved.motion, detections)
    marks = assign(frame, guess.c, seen, scene.cameras, moved.motion)
    points = FiducialPoints.joined([marks, referred])
    whole = _with_board(problem, points, frame, scene, moved.motion, guess.c)
    adjusted = adjust(whole, moved.motion, guess.c)
    return Mapping(adjusted, whole, outline, guess.either_way, _shift(frame, scene, adjusted))


def _guess(
    frame: Frame, scene: Scene, moved: AdjustmentResult, known: Known, referred: FiducialPoints
) -> tuple[Hypothesis | Failure, tuple[Detections, ...], Outline | None]:
    """A first C, the sightings it was found among, and how plainly the outline agrees."""
    guess, detections = _first_guess(frame, scene, moved, known), known.detections
    outline = _outline(frame, scene, moved.motion, guess)
    if known.method.marks and (isinstance(guess, Failure) or (outline is not None and not outline.visible)):
        deep = tuple(look_deeper(frame.board_type, scene, detections, fixture=known.method.fixture))
        second = _first_guess(frame, scene, moved, replace(known, detections=deep))
        if isinstance(second, Hypothesis) or isinstance(guess, Failure):
            guess, detections, outline = second, deep, _outline(frame, scene, moved.motion, second)
    if isinstance(guess, Failure) and known.reference is not None and len(referred.row) >= _LEAST_REFERRED:
        c = first_similarity(frame, known.reference, referred, moved.motion)
        guess = Hypothesis(c, 0.0, ())
        outline = _outline(frame, scene, moved.motion, guess)
    return guess, detections, outline


def _first_guess(frame: Frame, scene: Scene, moved: AdjustmentResult, known: Known) -> Hypothesis | Failure:
    """C from the sightings, unless the pictures say that the board lies the other way round."""
    if not known.method.marks:
        return Failure("no point of the run was found again in the reference")
    expectation, detections = known.expectation, known.detections
    angle = expected_angle(frame, scene.cameras[0], expectation)
    places = gather(detections, scene.cameras, moved.motion)
    texture = known.texture_mm
    guess = find_board(frame, places, angle, expectation, texture)
    if isinstance(guess, Failure):
        return guess
    turned = find_board(frame, places, angle + np.pi, expectation, texture)
    if isinstance(turned, Hypothesis) and len(turned.fiducials) >= len(guess.fiducials):
        seen_as = check(frame.board_type, frame.matrix(guess.c), frame.matrix(turned.c), scene, moved.motion)
        if seen_as is not None and seen_as.contradicts:
            return _turned_round(frame, seen_as)
        if seen_as is None or not seen_as.confirms:
            return _undecided(frame, guess, turned)
    return guess


def _undecided(frame: Frame, guess: Hypothesis, turned: Hypothesis) -> Hypothesis | Failure:
    """The pictures do not tell how the board lies: more fiducials do, equally many leave it open."""
    fit, fit_turned = len(guess.fiducials), len(turned.fiducials)
    if fit_turned > fit:
        return Failure(
            f"the board lies turned by 180°, or is of another type than {frame.board_type.name!r}: "
            f"{fit_turned} of its fiducials fit the turned board, {fit} the board as expected"
        )
    return replace(guess, either_way=True)


def _outline(frame: Frame, scene: Scene, motion: Motion, guess: Hypothesis | Failure) -> Outline | None:
    if isinstance(guess, Failure):
        return None
    return outline_of(frame.board_type, frame.matrix(guess.c), scene, motion)


def _shift(frame: Frame, scene: Scene, adjusted: AdjustmentResult) -> Shift | None:
    if adjusted.similarity is None:
        return None
    return outline_shift(frame.board_type, frame.matrix(adjusted.similarity), scene, adjusted.motion)


def _turned_round(frame: Frame, seen_as: Orientation) -> Failure:
    contrast = f"{seen_as.turned:.0f} against {seen_as.as_placed:.0f} grey levels"
    return Failure(
        f"the board lies turned by 180°, or is of another type than {frame.board_type.name!r}: "
        f"by its {seen_as.evidence} the pictures fit the turned board (edge contrast {contrast})"
    )


def _with_board(
    problem: Problem, points: FiducialPoints, frame: Frame, scene: Scene, motion: Motion, c: Floats
) -> Problem:
    """The problem with fiducials, the surface (where cameras know their height), and the component of every link."""
    on_board = motion.board(problem.links.p, problem.links.a_mm)
    marks = motion.board(points.row, points.ground_mm)
    at_links, at_marks = (basis_at_board(frame.board_type, frame.matrix(c), at) for at in (on_board, marks))
    knows_height = all(camera.working_distance_mm is not None for camera in scene.cameras)
    return replace(
        problem,
        component=component_of(frame, c, on_board),
        fiducials=points,
        nominal_scale=frame.board_type.mm_per_unit,
        surface=SurfaceBasis(at_links, at_marks, SIGMA_MM) if knows_height else None,
    )

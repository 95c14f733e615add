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
from vaoi_station.stitching.board.board_plane import BoardPlane, expected_angle
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.fiducial_assignment import (
    Hypothesis,
    assign_fiducials,
    find_board,
    merge_detections,
)
from vaoi_station.stitching.board.fiducial_detection import detect_more_marks, relocate_fiducials
from vaoi_station.stitching.board.footprints import component_at
from vaoi_station.stitching.board.orientation import Orientation, OutlineContrast, check, measure_outline_contrast
from vaoi_station.stitching.board.outline import OutlineShift, measure_outline_shift
from vaoi_station.stitching.board.reference import Reference, cad_points, initial_similarity
from vaoi_station.stitching.matching.evidence import Detections, Links
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import Method

_LEAST_REFERRED = 12
"""Points linked to a reference before it may place a board by itself."""


@dataclass(frozen=True, eq=False)
class CadMapping:
    """The board found: the whole adjustment, its problem, and what supports it."""

    adjusted: AdjustmentResult
    problem: Problem
    outline: OutlineContrast | None
    """Contrast along the board's outline as placed; None where no frame shows it."""
    ambiguous: bool = False
    """The board might lie turned by 180° as well: neither fiducials nor pictures tell."""
    shift: OutlineShift | None = None
    """Of the board's outline against the adjusted fiducials; None where too little of it shows an edge."""


@dataclass(frozen=True, eq=False)
class MappingInputs:
    """What a mapping may rest on."""

    expectation: Expectation
    method: Method
    detections: tuple[Detections, ...]
    texture_mm: Floats
    """(k, 2) places on the board that were linked from row to row."""
    reference: Reference | None = None
    reference_links: tuple[Links, ...] = ()


def map_cad(
    plane: BoardPlane, scene: Scene, problem: Problem, moved: AdjustmentResult, known: MappingInputs
) -> CadMapping | Failure:
    """Find the board, look for its marks again where they must be, and adjust everything together."""
    referred = FiducialPoints.empty()
    if known.reference is not None and known.method.reference:
        referred = cad_points(known.reference_links, scene.cameras, plane, known.reference)
    guess, detections, outline = _guess(plane, scene, moved, known, referred)
    if isinstance(guess, Failure):
        return guess
    seen = relocate_fiducials(plane.board_type, plane.matrix(guess.c), scene, moved.motion, detections)
    marks = assign_fiducials(plane, guess.c, seen, scene.cameras, moved.motion)
    points = FiducialPoints.joined([marks, referred])
    whole = _with_board(problem, points, plane, scene, moved.motion, guess.c)
    adjusted = adjust(whole, moved.motion, guess.c)
    return CadMapping(adjusted, whole, outline, guess.ambiguous, _shift(plane, scene, adjusted))


def _guess(
    plane: BoardPlane, scene: Scene, moved: AdjustmentResult, known: MappingInputs, referred: FiducialPoints
) -> tuple[Hypothesis | Failure, tuple[Detections, ...], OutlineContrast | None]:
    """A first C, the sightings it was found among, and how plainly the outline agrees."""
    guess, detections = _first_guess(plane, scene, moved, known), known.detections
    outline = _outline(plane, scene, moved.motion, guess)
    if known.method.marks and (isinstance(guess, Failure) or (outline is not None and not outline.visible)):
        deep = tuple(detect_more_marks(plane.board_type, scene, detections, fixture=known.method.fixture))
        second = _first_guess(plane, scene, moved, replace(known, detections=deep))
        if isinstance(second, Hypothesis) or isinstance(guess, Failure):
            guess, detections, outline = second, deep, _outline(plane, scene, moved.motion, second)
    if isinstance(guess, Failure) and known.reference is not None and len(referred.row) >= _LEAST_REFERRED:
        c = initial_similarity(plane, known.reference, referred, moved.motion)
        guess = Hypothesis(c, 0.0, ())
        outline = _outline(plane, scene, moved.motion, guess)
    return guess, detections, outline


def _first_guess(
    plane: BoardPlane, scene: Scene, moved: AdjustmentResult, known: MappingInputs
) -> Hypothesis | Failure:
    """C from the sightings, unless the pictures say that the board lies the other way round."""
    if not known.method.marks:
        return Failure("no point of the run was found again in the reference")
    expectation, detections = known.expectation, known.detections
    angle = expected_angle(plane, scene.cameras[0], expectation)
    places = merge_detections(detections, scene.cameras, moved.motion)
    texture = known.texture_mm
    guess = find_board(plane, places, angle, expectation, texture)
    if isinstance(guess, Failure):
        return guess
    turned = find_board(plane, places, angle + np.pi, expectation, texture)
    if isinstance(turned, Hypothesis) and len(turned.fiducials) >= len(guess.fiducials):
        seen_as = check(plane.board_type, plane.matrix(guess.c), plane.matrix(turned.c), scene, moved.motion)
        if seen_as is not None and seen_as.contradicts:
            return _turned_round(plane, seen_as)
        if seen_as is None or not seen_as.confirms:
            return _undecided(plane, guess, turned)
    return guess


def _undecided(plane: BoardPlane, guess: Hypothesis, turned: Hypothesis) -> Hypothesis | Failure:
    """The pictures do not tell how the board lies: more fiducials do, equally many leave it open."""
    fit, fit_turned = len(guess.fiducials), len(turned.fiducials)
    if fit_turned > fit:
        return Failure(
            f"the board lies turned by 180°, or is of another type than {plane.board_type.name!r}: "
            f"{fit_turned} of its fiducials fit the turned board, {fit} the board as expected"
        )
    return replace(guess, ambiguous=True)


def _outline(plane: BoardPlane, scene: Scene, motion: Motion, guess: Hypothesis | Failure) -> OutlineContrast | None:
    if isinstance(guess, Failure):
        return None
    return measure_outline_contrast(plane.board_type, plane.matrix(guess.c), scene, motion)


def _shift(plane: BoardPlane, scene: Scene, adjusted: AdjustmentResult) -> OutlineShift | None:
    if adjusted.similarity is None:
        return None
    return measure_outline_shift(plane.board_type, plane.matrix(adjusted.similarity), scene, adjusted.motion)


def _turned_round(plane: BoardPlane, seen_as: Orientation) -> Failure:
    contrast = f"{seen_as.turned:.0f} against {seen_as.as_placed:.0f} grey levels"
    return Failure(
        f"the board lies turned by 180°, or is of another type than {plane.board_type.name!r}: "
        f"by its {seen_as.evidence} the pictures fit the turned board (edge contrast {contrast})"
    )


def _with_board(
    problem: Problem, points: FiducialPoints, plane: BoardPlane, scene: Scene, motion: Motion, c: Floats
) -> Problem:
    """The problem with fiducials, the surface (where cameras know their height), and the component of every link."""
    on_board = motion.board(problem.links.p, problem.links.a_mm)
    marks = motion.board(points.row, points.ground_mm)
    at_links, at_marks = (basis_at_board(plane.board_type, plane.matrix(c), at) for at in (on_board, marks))
    knows_height = all(camera.working_distance_mm is not None for camera in scene.cameras)
    return replace(
        problem,
        component=component_at(plane, c, on_board),
        fiducials=points,
        nominal_scale=plane.board_type.mm_per_unit,
        surface=SurfaceBasis(at_links, at_marks, SIGMA_MM) if knows_height else None,
    )

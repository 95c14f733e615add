"""The CAD mapping of a run: which sightings are the fiducials, does the board really lie so, then one adjustment.

A first answer comes from the marks seen while filming. It is believed when the pictures do not
contradict it: the board's outline must be where the fiducials put it. Otherwise the frames are
searched once more, deeply, before the mapping is given up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment import Adjusted, FiducialPoints, Problem, SurfaceBasis, adjust
from vaoi_station.stitching.cad import Frame, Hypothesis, assign, expected_angle, find_board, gather
from vaoi_station.stitching.evidence import Sightings
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.footprints import component_of
from vaoi_station.stitching.motion import Motion
from vaoi_station.stitching.observations import Observations
from vaoi_station.stitching.orientation import Orientation, Outline, check, outline_of
from vaoi_station.stitching.scene import Scene
from vaoi_station.stitching.sight import look_again, look_deeper
from vaoi_station.stitching.surface import SIGMA_MM, basis_on_board


@dataclass(frozen=True, eq=False)
class Mapping:
    """The board found: the whole adjustment, its problem, and what supports it."""

    adjusted: Adjusted
    problem: Problem
    which: tuple[int, ...]
    """Number of the fiducial of every sighting used."""
    outline: Outline | None
    """Contrast along the board's outline as placed; None where no frame shows it."""
    either_way: bool = False
    """The board might lie turned by 180° as well: neither fiducials nor pictures tell."""


def map_cad(
    frame: Frame,
    scene: Scene,
    expectation: Expectation,
    problem: Problem,
    moved: Adjusted,
    sightings: Sequence[Sightings],
) -> Mapping | Failure:
    """Find the fiducials, look for them again where they must be, and adjust everything together."""
    guess = _first_guess(frame, scene, expectation, problem, moved, sightings)
    outline = _outline(frame, scene, moved.motion, guess)
    if isinstance(guess, Failure) or (outline is not None and not outline.visible):
        deep = look_deeper(frame.board_type, scene, sightings)
        second = _first_guess(frame, scene, expectation, problem, moved, deep)
        if isinstance(second, Hypothesis) or isinstance(guess, Failure):
            guess, sightings, outline = second, deep, _outline(frame, scene, moved.motion, second)
    if isinstance(guess, Failure):
        return guess
    seen = look_again(frame.board_type, frame.matrix(guess.c), scene, moved.motion, sightings)
    points, which = assign(frame, guess.c, seen, scene.cameras, moved.motion)
    whole = _with_board(problem, points, frame, scene, moved.motion, guess.c)
    return Mapping(adjust(whole, moved.motion, guess.c), whole, tuple(which), outline, guess.either_way)


def _first_guess(
    frame: Frame,
    scene: Scene,
    expectation: Expectation,
    problem: Problem,
    moved: Adjusted,
    sightings: Sequence[Sightings],
) -> Hypothesis | Failure:
    """C from the sightings, unless the pictures say that the board lies the other way round."""
    angle = expected_angle(frame, scene.cameras[0], expectation)
    places = gather(sightings, scene.cameras, moved.motion)
    texture = _texture(problem.links, moved)
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
    at_links, at_marks = (basis_on_board(frame.board_type, frame.matrix(c), at) for at in (on_board, marks))
    knows_height = all(camera.working_distance_mm is not None for camera in scene.cameras)
    return replace(
        problem,
        component=component_of(frame, c, on_board),
        fiducials=points,
        nominal_scale=frame.board_type.mm_per_unit,
        surface=SurfaceBasis(at_links, at_marks, SIGMA_MM) if knows_height else None,
    )


def _texture(links: Observations, moved: Adjusted) -> Floats:
    """Places on the board that were linked from row to row and move as the board does."""
    use = (moved.weight > 0.5) & (links.p != links.q)
    return moved.motion.board(links.p[use], links.a_mm[use])

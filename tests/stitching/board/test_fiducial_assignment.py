"""Assignment of detections to fiducials, and the first C."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane, expected_angle
from vaoi_station.stitching.board.fiducials import (
    FiducialCandidates,
    Hypothesis,
    assign_fiducials,
    find_board,
    find_rough_places,
    merge_detections,
    outside_share,
)
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Detections, Task

Array = NDArray[np.float64]
FIDUCIALS = (("A", 3.0, 3.0), ("B", 37.0, 17.5), ("C", 36.0, 3.5))
UPRIGHT = Expectation()
NOTHING = np.zeros((0, 2))


def board(
    y_axis: Literal["up", "down"] = "up",
    side: Literal["top", "bottom"] = "top",
    fiducials: tuple[tuple[str, float, float], ...] = FIDUCIALS,
    unit: Literal["mm", "inch", "mil"] = "mm",
) -> BoardType:
    k = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}[unit]
    return BoardType.model_validate(
        {
            "name": "board",
            "unit": unit,
            "y_axis": y_axis,
            "side": side,
            "outline": [[0, 0], [40 / k, 20 / k]],
            "fiducials": [{"name": n, "x": x / k, "y": y / k, "diameter": 1.0 / k} for n, x, y in fiducials],
        }
    )


def placed(plane: BoardPlane, camera: Any, turn_rad: float = 0.0, at: tuple[float, float] = (12.0, -30.0)) -> Array:
    """Make the similarity of a board that lies as expected except for a turn, with its middle at a place."""
    angle = expected_angle(plane, camera, UPRIGHT) + turn_rad
    scale = plane.board_type.mm_per_unit
    a, b = scale * math.cos(angle), scale * math.sin(angle)
    low, high = plane.board_type.extent()
    middle = apply_similarity(np.array([a, b, 0, 0]), plane.flat((low + high) / 2)[None])[0]
    return np.array([a, b, at[0] - middle[0], at[1] - middle[1]])


def candidates_at(mm: Array, score: float = 0.97) -> FiducialCandidates:
    return FiducialCandidates(mm, np.zeros(len(mm), dtype=np.int_), np.full(len(mm), score))


def with_look_alikes(
    places: FiducialCandidates, count: int, g: np.random.Generator, score: tuple[float, float]
) -> FiducialCandidates:
    more = g.uniform((-15, -50), (40, -10), (count, 2))
    kept = np.concatenate([places.mm, more])
    order = g.permutation(len(kept))
    scores = np.concatenate([places.score, g.uniform(*score, count)])
    return FiducialCandidates(kept[order], np.zeros(len(kept), dtype=np.int_), scores[order])


@pytest.mark.parametrize("y_up_in_tester", [False, True])
@pytest.mark.parametrize("side", ["top", "bottom"])
@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_handedness_follows_from_board_type_and_cameras(
    workshop: Any, y_axis: Literal["up", "down"], side: Literal["top", "bottom"], y_up_in_tester: bool
) -> None:
    """An upright board shows CAD x to the right on the top side, to the left on the bottom; CAD up points up."""
    camera = workshop.camera((12.0, -30.0), angle_rad=0.01, y_up=y_up_in_tester)
    plane = board_plane(board(y_axis, side), camera)
    truth = placed(plane, camera, 0.02)
    found = find_board(
        plane,
        candidates_at(apply_similarity(truth, plane.fiducials)),
        expected_angle(plane, camera, UPRIGHT),
        UPRIGHT,
        NOTHING,
    )
    assert isinstance(found, Hypothesis)
    assert found.c == pytest.approx(truth, abs=1e-9)
    image_from_cad = camera.image_from_row.matrix @ plane.matrix(found.c)
    mirrors = np.linalg.det(image_from_cad / image_from_cad[2, 2]) < 0
    assert mirrors == ((y_axis == "up") != (side == "bottom"))
    middle, right, up = (apply(image_from_cad, p) for p in ((20, 10), (21, 10), (20, 11 if y_axis == "up" else 9)))
    assert (right - middle)[0] * (1 if side == "top" else -1) > 9
    assert (up - middle)[1] < -9


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(-0.1, 0.1))
def test_fiducials_win_over_look_alikes(workshop: Any, seed: int, turn: float) -> None:
    g = np.random.default_rng(seed)
    camera = workshop.camera()
    plane = board_plane(board(), camera)
    truth = placed(plane, camera, turn)
    marks = apply_similarity(truth, plane.fiducials) + g.normal(0, 0.01, (3, 2))
    places = with_look_alikes(candidates_at(marks), 60, g, (0.75, 0.93))
    found = find_board(plane, places, expected_angle(plane, camera, UPRIGHT), UPRIGHT, NOTHING)
    assert isinstance(found, Hypothesis)
    assert np.abs(apply_similarity(found.c, plane.fiducials) - marks).max() < 0.4, (
        "a first answer, from two of the three"
    )
    assert found.fiducials == (0, 1, 2)


def test_a_board_far_from_its_direction_is_refused_with_the_angle(workshop: Any) -> None:
    camera = workshop.camera()
    plane = board_plane(board(), camera)
    places = candidates_at(apply_similarity(placed(plane, camera, 0.3), plane.fiducials))
    refused = find_board(plane, places, expected_angle(plane, camera, UPRIGHT), UPRIGHT, NOTHING)
    assert isinstance(refused, Failure)
    assert "turned by 17.2°" in refused.reason


def test_texture_must_lie_on_the_board(workshop: Any) -> None:
    """Two pairs of marks fit equally well; the linked texture decides."""
    camera, g = workshop.camera(), np.random.default_rng(1)
    plane = board_plane(board(fiducials=FIDUCIALS[:2]), camera)
    here, there = placed(plane, camera), placed(plane, camera, at=(12.0, 40.0))
    both = np.concatenate([apply_similarity(c, plane.fiducials) for c in (there, here)])
    texture = apply_similarity(here, plane.flat(g.uniform((0, 0), (40, 20), (200, 2))))
    found = find_board(plane, candidates_at(both), expected_angle(plane, camera, UPRIGHT), UPRIGHT, texture)
    assert isinstance(found, Hypothesis)
    assert found.c == pytest.approx(here, abs=1e-6)
    assert outside_share(plane, here, texture) == 0
    assert outside_share(plane, there, texture) == 1
    refused = find_board(plane, candidates_at(both[:2]), expected_angle(plane, camera, UPRIGHT), UPRIGHT, texture)
    assert isinstance(refused, Failure)


def test_detections_of_one_mark_in_several_frames_are_merged_and_all_assigned(workshop: Any) -> None:
    cameras = (workshop.camera((0, 0)), workshop.camera((4, 0)))
    motion = nominal_motion(np.array([0.0, 0.1]), np.array([0.0, 50.0]), np.zeros(2))
    plane = board_plane(board(), cameras[0])
    c = placed(plane, cameras[0], at=(-8.0, -9.0))
    marks = apply_similarity(c, plane.fiducials)
    detections, seen = [], []
    for i, camera in enumerate(cameras):
        for j in (0, 1):
            px = camera.project(motion.row_from_tester(j)(marks))
            inside = np.flatnonzero(camera.sees(px, 5))
            k = len(inside)
            seen += inside.tolist()
            detections.append(
                Detections(Task("marks", (i, j)), px[inside], np.full(k, 0.01), np.full(k, 0.9), np.zeros(k, dtype=int))
            )
    places = merge_detections(detections, cameras, motion)
    assert len(places.mm) == len(set(seen))
    assert len(seen) > len(set(seen)), "a mark is in the overlap"
    points = assign_fiducials(plane, c, detections, cameras, motion)
    assert sorted(points.which.tolist()) == sorted(seen)
    assert points.px_per_mm == pytest.approx(10.0)
    assert points.sigma_mm == pytest.approx(0.001)
    on_board = motion.board(points.row, points.ground_mm)
    np.testing.assert_allclose(on_board, apply_similarity(c, points.cad), atol=1e-9)


def test_rough_places_allow_a_wrong_scale_along_the_motion_and_keep_rivals(workshop: Any) -> None:
    """Texture below the board gives a motion that is wrong by a per cent; a carrier may repeat the fiducials."""
    camera = workshop.camera()
    plane = board_plane(board(), camera)
    angle, truth = expected_angle(plane, camera, UPRIGHT), placed(plane, camera)
    marks = apply_similarity(truth, plane.fiducials)
    stretched = marks.mean(0) + (marks - marks.mean(0)) * (1.0, 1.01)
    rival = stretched[:2] + (0.0, -8.0)
    places = find_rough_places(plane, candidates_at(np.vstack([stretched, rival])), angle, UPRIGHT)
    assert len(places) >= 2
    assert set(places[0].fiducials) == {0, 1, 2}
    assert np.abs(apply_similarity(places[0].c, plane.fiducials) - stretched).max() < 1.0
    assert min(np.abs(apply_similarity(h.c, plane.fiducials[:2]) - rival).max() for h in places) < 1.0
    turned = placed(plane, camera, math.pi / 2)
    assert not find_rough_places(plane, candidates_at(apply_similarity(turned, plane.fiducials)), angle, UPRIGHT)

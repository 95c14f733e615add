from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.link import choose_places, link_frames, link_neighbours
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame

SIZE = (480, 360)
SCALE = 10.0
ROWS = Task("rows", (0, 0), (0, 1), 0.1)


def motion(angle: float, x: float, y: float) -> NDArray[np.float64]:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


def filmed(workshop: Any, camera: Any, row_from_board: NDArray[np.float64]) -> PreparedFrame:
    waves = workshop.waves(11, finest=0.6, coarsest=12.0)
    return PreparedFrame(waves.seen_by(camera, lambda at: apply(np.linalg.inv(row_from_board), at)))


@settings(max_examples=6, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    angle=st.floats(-0.02, 0.02),
    yaw=st.floats(-0.003, 0.003),
    slip=st.tuples(st.floats(-0.8, 0.8), st.floats(-2.0, 2.0)),
)
def test_links_between_rows_are_the_same_points_of_the_board(
    workshop: Any, angle: float, yaw: float, slip: tuple[float, float]
) -> None:
    camera = workshop.camera((0, 0), size_px=SIZE, angle_rad=angle, tilt=(1e-5, -2e-5))
    nominal = np.array([0.0, 12.0])
    d = motion(yaw, slip[0], nominal[1] + slip[1])
    links = link_frames(ROWS, filmed(workshop, camera, np.eye(3)), filmed(workshop, camera, d), camera, camera, nominal)
    assert len(links.a_px) >= 30, links.note
    off = camera.project(apply(d, camera.ground(links.a_px))) - links.b_px
    assert np.abs(np.median(off, axis=0)).max() < 0.012
    assert (np.hypot(*off.T) < 0.12).mean() > 0.95
    assert links.coarse_px is not None
    assert np.abs(np.array(links.coarse_px) - SCALE * np.array(slip)).max() < 6


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.004, -0.003), (-0.008, 0.008)])
def test_neighbours_are_linked_by_their_calibration_though_turned(workshop: Any, angles: tuple[float, float]) -> None:
    left, right = (workshop.camera((x, 0), size_px=SIZE, angle_rad=t) for x, t in zip((0, 38), angles, strict=True))
    task = Task("neighbours", (0, 3), (1, 3))
    links = link_neighbours(task, filmed(workshop, left, np.eye(3)), filmed(workshop, right, np.eye(3)), left, right)
    assert len(links.a_px) >= 20
    assert links.task is task
    off_px = SCALE * (left.ground(links.a_px) - right.ground(links.b_px))
    assert np.abs(np.median(off_px, axis=0)).max() < 0.012
    assert np.hypot(*off_px.T).max() < 0.02 + 10 * abs(angles[0] - angles[1])


@pytest.mark.parametrize("overlap_px", [26, 30, 34, 38, 44, 52, 60])
def test_neighbours_that_hardly_overlap_are_not_said_to_have_moved(workshop: Any, overlap_px: int) -> None:
    """Patches keep off the borders, so that an overlap of 34 px has room for none, and a somewhat wider one for few."""
    left, right = (workshop.camera((x, 0), size_px=SIZE) for x in (0.0, (SIZE[0] - overlap_px) / SCALE))
    frames = filmed(workshop, left, np.eye(3)), filmed(workshop, right, np.eye(3))
    links = link_neighbours(Task("neighbours", (0, 0), (1, 0)), *frames, left, right)
    assert not links.unmatched
    assert (len(links.a_px) > 0) == (overlap_px >= 36)


@pytest.mark.parametrize(("overlap_px", "told"), [(30, False), (36, True), (44, True), (60, True)])
def test_neighbours_that_show_different_things_are_told_wherever_there_is_room(
    workshop: Any, overlap_px: int, told: bool
) -> None:
    left, right = (workshop.camera((x, 0), size_px=SIZE) for x in (0.0, (SIZE[0] - overlap_px) / SCALE))
    elsewhere = filmed(workshop, right, motion(0.0, 0.0, 200.0))
    task = Task("neighbours", (0, 0), (1, 0))
    assert link_neighbours(task, filmed(workshop, left, np.eye(3)), elsewhere, left, right).unmatched is told


def test_what_stops_a_link_is_noted(workshop: Any) -> None:
    camera = workshop.camera(size_px=SIZE)
    board = filmed(workshop, camera, np.eye(3))
    g = np.random.default_rng(0)
    belt = PreparedFrame(workshop.digitised(20 + g.normal(0, 1.0, SIZE[::-1])))
    assert link_frames(ROWS, board, board, camera, camera, np.array([0, 40.0])).note == "the frames do not overlap"
    assert "empty" in link_frames(ROWS, belt, board, camera, camera, np.array([0, 12.0])).note
    assert "fits" in link_frames(ROWS, board, belt, camera, camera, np.array([0, 12.0])).note
    black = PreparedFrame(np.zeros(SIZE[::-1], dtype=np.uint8))
    neighbours = Task("neighbours", (0, 0), (1, 0))
    assert "no textured place" in link_neighbours(neighbours, black, board, camera, camera).note
    assert "correlation" in link_neighbours(neighbours, board, belt, camera, camera).note
    far = workshop.camera((100, 0), size_px=SIZE)
    assert link_neighbours(neighbours, board, board, camera, far).note == "the frames do not overlap"


@given(st.tuples(st.integers(-20, 500), st.integers(-20, 380)), st.integers(0, 500), st.integers(0, 380))
def test_places_lie_inside_their_box(corner: tuple[int, int], width: int, height: int) -> None:
    frame = noise()
    x0, y0 = max(corner[0], 0), max(corner[1], 0)
    box = x0, y0, min(x0 + width, SIZE[0]), min(y0 + height, SIZE[1])
    at = choose_places(frame, box)
    assert len(at) <= 2 * 80
    assert ((at >= box[:2]) & (at < box[2:])).all()


def test_bare_belt_offers_no_places_beside_a_board(workshop: Any) -> None:
    grey = np.full(SIZE[::-1], 20, dtype=np.uint8)
    grey[:, :240] = workshop.waves(1).picture(240, SIZE[1])
    at = choose_places(PreparedFrame(grey), (0, 0, *SIZE))
    assert len(at) > 20
    assert at[:, 0].max() < 250


@cache
def noise() -> PreparedFrame:
    return PreparedFrame(np.random.default_rng(0).integers(0, 256, SIZE[::-1], dtype=np.uint8))


@pytest.mark.parametrize("task", [ROWS, Task("neighbours", (0, 0), (1, 0))])
def test_no_evidence_is_evidence_of_having_looked(task: Task) -> None:
    none = Links.empty(task, "why")
    assert (none.task, none.note) == (task, "why")
    assert [len(v) for v in (none.a_px, none.b_px, none.information, none.score)] == [0] * 4

"""Links between rows and between cameras of a simulated texture are corresponding points."""

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
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.link import are_copies, choose_corners, link_neighbours, link_reference, link_rows

SIZE = (480, 360)
SCALE = 10.0
ROWS = Task("rows", (0, 0), (0, 1), 0.1)
NEIGHBOURS = Task("neighbours", (0, 0), (1, 0))


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
    a, b = filmed(workshop, camera, np.eye(3)), filmed(workshop, camera, d)
    links = link_rows(ROWS, FramePair(a, b, camera, camera, nominal))
    assert len(links.a_px) >= 30, links.note
    off = camera.project(apply(d, camera.ground(links.a_px))) - links.b_px
    assert np.abs(np.median(off, axis=0)).max() < 0.012
    assert (np.hypot(*off.T) < 0.12).mean() > 0.95
    assert links.coarse_px is not None
    assert np.abs(np.array(links.coarse_px) - SCALE * np.array(slip)).max() < 6


def test_a_frame_that_was_sent_twice_has_no_links(workshop: Any) -> None:
    camera, nominal = workshop.camera((0, 0), size_px=SIZE), np.array([0.0, 12.0])
    a = filmed(workshop, camera, np.eye(3))
    again = PreparedFrame(a.grey.copy())
    links = link_rows(ROWS, FramePair(a, again, camera, camera, nominal))
    assert links.copied
    assert not len(links.a_px)
    assert links.note == "the second frame is a copy of the first"


def test_one_other_pixel_or_a_single_grey_level_makes_no_copy(workshop: Any) -> None:
    frame = filmed(workshop, workshop.camera((0, 0), size_px=SIZE), np.eye(3)).grey
    other = frame.copy()
    other[101, 7] ^= 1
    assert are_copies(frame, frame.copy())
    assert not are_copies(frame, other)
    assert not are_copies(frame, frame[:-1])
    assert not are_copies(np.full_like(frame, 255), np.full_like(frame, 255)), "saturated, but not sent twice"


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.004, -0.003), (-0.008, 0.008)])
def test_neighbours_are_linked_by_their_calibration_even_if_rotated(workshop: Any, angles: tuple[float, float]) -> None:
    left, right = (workshop.camera((x, 0), size_px=SIZE, angle_rad=t) for x, t in zip((0, 38), angles, strict=True))
    task = Task("neighbours", (0, 3), (1, 3))
    a, b = filmed(workshop, left, np.eye(3)), filmed(workshop, right, np.eye(3))
    links = link_neighbours(task, FramePair(a, b, left, right, np.zeros(2)))
    assert len(links.a_px) >= 20
    assert links.task is task
    off_px = SCALE * (left.ground(links.a_px) - right.ground(links.b_px))
    assert np.abs(np.median(off_px, axis=0)).max() < 0.012
    assert np.hypot(*off_px.T).max() < 0.02 + 10 * abs(angles[0] - angles[1])


def neighbours(workshop: Any, overlap_px: int, elsewhere_mm: float = 0.0) -> FramePair:
    """Two cameras side by side; the right one sees another part of the texture if `elsewhere_mm` is not 0."""
    left, right = (workshop.camera((x, 0), size_px=SIZE) for x in (0.0, (SIZE[0] - overlap_px) / SCALE))
    a, b = filmed(workshop, left, np.eye(3)), filmed(workshop, right, motion(0.0, 0.0, elsewhere_mm))
    return FramePair(a, b, left, right, np.zeros(2))


@pytest.mark.parametrize("overlap_px", [26, 30, 34, 38, 44, 52, 60])
def test_a_narrow_overlap_of_neighbours_is_no_sign_of_a_displaced_camera(workshop: Any, overlap_px: int) -> None:
    """Patches keep a margin to the borders: an overlap of 34 px has room for none, a slightly wider one for few."""
    links = link_neighbours(NEIGHBOURS, neighbours(workshop, overlap_px))
    assert not links.unmatched
    assert (len(links.a_px) > 0) == (overlap_px >= 36)


@pytest.mark.parametrize(("overlap_px", "unmatched"), [(30, False), (36, True), (44, True), (60, True)])
def test_neighbours_that_show_different_things_are_marked_where_there_is_room(
    workshop: Any, overlap_px: int, unmatched: bool
) -> None:
    assert link_neighbours(NEIGHBOURS, neighbours(workshop, overlap_px, 200.0)).unmatched is unmatched


def test_a_displaced_neighbour_is_linked_by_the_wider_search(workshop: Any) -> None:
    left, right = workshop.camera((0, 0), size_px=SIZE), workshop.camera((38, 0), size_px=SIZE)
    a, b = filmed(workshop, left, np.eye(3)), filmed(workshop, right, motion(0.0, 0.0, 2.5))
    links = link_neighbours(NEIGHBOURS, FramePair(a, b, left, right, np.zeros(2)))
    assert len(links.a_px) >= 8
    assert not links.unmatched
    assert links.coarse_px == pytest.approx((0.0, 2.5 * SCALE), abs=6)
    off_mm = right.ground(links.b_px) - left.ground(links.a_px)
    assert np.median(off_mm, axis=0) == pytest.approx([0.0, 2.5], abs=0.005)


@pytest.mark.parametrize("placed_mm", [(0.0, 0.0), (2.0, -3.0)])
def test_a_run_is_linked_to_its_reference_wherever_the_board_lies(
    workshop: Any, placed_mm: tuple[float, float]
) -> None:
    camera = workshop.camera(size_px=SIZE)
    a, b = filmed(workshop, camera, motion(0.0, *placed_mm)), filmed(workshop, camera, np.eye(3))
    links = link_reference(Task("reference", (0, 4), (0, 4)), FramePair(a, b, camera, camera, np.zeros(2)))
    assert len(links.a_px) >= 30
    off_mm = camera.ground(links.a_px) - camera.ground(links.b_px)
    assert np.median(off_mm, axis=0) == pytest.approx(placed_mm, abs=0.002)


def test_the_reason_for_missing_links_is_noted(workshop: Any) -> None:
    camera, far = workshop.camera(size_px=SIZE), workshop.camera((100, 0), size_px=SIZE)
    board = filmed(workshop, camera, np.eye(3))
    belt = PreparedFrame(workshop.digitised(20 + np.random.default_rng(0).normal(0, 1.0, SIZE[::-1])))
    black = PreparedFrame(np.zeros(SIZE[::-1], dtype=np.uint8))

    def row_note(a: PreparedFrame, b: PreparedFrame, y_mm: float) -> str:
        return link_rows(ROWS, FramePair(a, b, camera, camera, np.array([0, y_mm]))).note

    def neighbour_note(a: PreparedFrame, b: PreparedFrame, camera_b: Any = camera) -> str:
        return link_neighbours(NEIGHBOURS, FramePair(a, b, camera, camera_b, np.zeros(2))).note

    assert row_note(board, board, 40.0) == "the frames do not overlap"
    assert "empty" in row_note(belt, board, 12.0)
    assert "fits" in row_note(board, belt, 12.0)
    assert "no textured corner" in neighbour_note(black, board)
    assert "correlation" in neighbour_note(board, belt)
    assert neighbour_note(board, board, far) == "the frames do not overlap"
    reference = link_reference(ROWS, FramePair(black, board, camera, camera, np.zeros(2)))
    assert "empty" in reference.note
    assert not len(reference.a_px)


@given(st.tuples(st.integers(-20, 500), st.integers(-20, 380)), st.integers(0, 500), st.integers(0, 380))
def test_corners_lie_inside_their_box(corner: tuple[int, int], width: int, height: int) -> None:
    frame = noise()
    x0, y0 = max(corner[0], 0), max(corner[1], 0)
    box = x0, y0, min(x0 + width, SIZE[0]), min(y0 + height, SIZE[1])
    at = choose_corners(frame, box)
    assert len(at) <= 2 * 80
    assert ((at >= box[:2]) & (at < box[2:])).all()


def test_bare_belt_beside_a_board_has_no_corners(workshop: Any) -> None:
    grey = np.full(SIZE[::-1], 20, dtype=np.uint8)
    grey[:, :240] = workshop.waves(1).picture(240, SIZE[1])
    at = choose_corners(PreparedFrame(grey), (0, 0, *SIZE))
    assert len(at) > 20
    assert at[:, 0].max() < 250


@cache
def noise() -> PreparedFrame:
    return PreparedFrame(np.random.default_rng(0).integers(0, 256, SIZE[::-1], dtype=np.uint8))

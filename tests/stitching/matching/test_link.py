"""Texture that stands still, or has moved by a known distance, from textures that are formulas."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.frames import PreparedFrame, read_only
from vaoi_station.stitching.matching.link import (
    CoarseShift,
    best_corners,
    find_shift,
    link_neighbours,
    link_reference,
    link_rows,
)


def image(seed: int) -> NDArray[np.uint8]:
    g = np.random.default_rng(seed)
    soft = cv2.GaussianBlur(g.normal(128, 120, (60, 90)), (0, 0), 1.5)
    return np.asarray(np.clip(soft, 0, 255), dtype=np.uint8)


@settings(deadline=None)
@given(
    seed=st.integers(0, 1000),
    corner=st.tuples(st.integers(0, 30), st.integers(0, 20)),
    across=st.tuples(st.integers(1, 6), st.integers(1, 10)),
    down=st.tuples(st.integers(1, 4), st.integers(1, 10)),
)
def test_the_best_pixel_of_every_cell_is_that_of_opencv(
    seed: int, corner: tuple[int, int], across: tuple[int, int], down: tuple[int, int]
) -> None:
    grey, (x0, y0) = image(seed), corner
    score = cv2.cornerMinEigenVal(grey, 3, ksize=3)
    score[:2] = score[-2:] = score[:, :2] = score[:, -2:] = 0  # OpenCV mirrors what lies beyond the border
    (nx, width), (ny, height) = across, down
    cells = score[y0 : y0 + ny * height, x0 : x0 + nx * width].reshape(ny, height, nx, width)
    best = cells.max((1, 3)).ravel()
    found = best_corners(read_only(grey), x0, y0, across, down)
    least = max(0.003 * np.sort(best)[int(len(best) * 0.9)], 1e-5)
    assert abs(len(found) - (best > least).sum()) <= (np.abs(best - least) < 1e-7).sum()
    cell = (found[:, 1] - y0) // height * nx + (found[:, 0] - x0) // width
    assert len(set(cell.tolist())) == len(cell)
    np.testing.assert_allclose(score[found[:, 1], found[:, 0]], best[cell], rtol=1e-3, atol=1e-7)


SIZE = (640, 480)
REACH = np.array([40.0, 40.0])


def box(shift: tuple[float, float]) -> tuple[int, int, int, int]:
    """The part of frame a that is still in frame b after a shift of the content."""
    x, y = (round(v) for v in shift)
    return max(0, -x), max(0, -y), min(SIZE[0], SIZE[0] - x), min(SIZE[1], SIZE[1] - y)


@pytest.fixture(scope="module")
def frame(workshop: Any) -> PreparedFrame:
    return PreparedFrame(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE))


@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    nominal=st.tuples(st.integers(-200, 200), st.integers(-200, 200)),
    slip=st.tuples(st.integers(-36, 36), st.integers(-36, 36)),
)
def test_the_deviation_from_the_nominal_motion_is_found(
    workshop: Any, frame: PreparedFrame, nominal: tuple[int, int], slip: tuple[int, int]
) -> None:
    shift = (nominal[0] + slip[0], nominal[1] + slip[1])
    b = PreparedFrame(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE, shift))
    found = find_shift(frame, b, box(nominal), np.array(nominal, dtype=float), REACH)
    assert isinstance(found, CoarseShift), found
    assert np.abs(found.px - slip).max() <= 2.0
    assert found.score > 0.5


@pytest.mark.parametrize("slip", [(-14, 9), (15, -15)])
def test_the_repetition_within_the_prior_is_taken(workshop: Any, slip: tuple[int, int]) -> None:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)

    def pins(dx: float, dy: float) -> PreparedFrame:
        grey = 120 + 50 * np.cos(2 * np.pi * (x - dx) / 48) + 50 * np.cos(2 * np.pi * (y - dy) / 48)
        return PreparedFrame(workshop.digitised(grey))

    nominal = np.array([0.0, 144.0])
    found = find_shift(pins(0, 0), pins(slip[0], 144 + slip[1]), box((0, 144)), nominal, np.array([20.0, 20.0]))
    assert isinstance(found, CoarseShift)
    assert np.abs(found.px - slip).max() <= 2.0


FRAME_PX = (480, 360)
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
    camera = workshop.camera((0, 0), size_px=FRAME_PX, angle_rad=angle, tilt=(1e-5, -2e-5))
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
    camera, nominal = workshop.camera((0, 0), size_px=FRAME_PX), np.array([0.0, 12.0])
    a = filmed(workshop, camera, np.eye(3))
    again = PreparedFrame(a.grey.copy())
    links = link_rows(ROWS, FramePair(a, again, camera, camera, nominal))
    assert links.copied
    assert not len(links.a_px)
    assert links.note == "the second frame is a copy of the first"


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.004, -0.003), (-0.008, 0.008)])
def test_neighbours_are_linked_by_their_calibration_even_if_rotated(workshop: Any, angles: tuple[float, float]) -> None:
    left, right = (workshop.camera((x, 0), size_px=FRAME_PX, angle_rad=t) for x, t in zip((0, 38), angles, strict=True))
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
    left, right = (workshop.camera((x, 0), size_px=FRAME_PX) for x in (0.0, (FRAME_PX[0] - overlap_px) / SCALE))
    a, b = filmed(workshop, left, np.eye(3)), filmed(workshop, right, motion(0.0, 0.0, elsewhere_mm))
    return FramePair(a, b, left, right, np.zeros(2))


@pytest.mark.parametrize("overlap_px", [30, 34, 38, 60])
def test_a_narrow_overlap_of_neighbours_is_no_sign_of_a_displaced_camera(workshop: Any, overlap_px: int) -> None:
    """Patches keep a margin to the borders: an overlap of 34 px has room for none, a slightly wider one for few."""
    links = link_neighbours(NEIGHBOURS, neighbours(workshop, overlap_px))
    assert not links.unmatched
    assert (len(links.a_px) > 0) == (overlap_px >= 36)


@pytest.mark.parametrize(("overlap_px", "unmatched"), [(30, False), (36, True), (60, True)])
def test_neighbours_that_show_different_things_are_marked_where_there_is_room(
    workshop: Any, overlap_px: int, unmatched: bool
) -> None:
    assert link_neighbours(NEIGHBOURS, neighbours(workshop, overlap_px, 200.0)).unmatched is unmatched


@pytest.mark.parametrize("placed_mm", [(0.0, 0.0), (2.0, -3.0)])
def test_a_run_is_linked_to_its_reference_wherever_the_board_lies(
    workshop: Any, placed_mm: tuple[float, float]
) -> None:
    camera = workshop.camera(size_px=FRAME_PX)
    a, b = filmed(workshop, camera, motion(0.0, *placed_mm)), filmed(workshop, camera, np.eye(3))
    links = link_reference(Task("reference", (0, 4), (0, 4)), FramePair(a, b, camera, camera, np.zeros(2)))
    assert len(links.a_px) >= 30
    off_mm = camera.ground(links.a_px) - camera.ground(links.b_px)
    assert np.median(off_mm, axis=0) == pytest.approx(placed_mm, abs=0.002)


def test_the_reason_for_missing_links_is_noted(workshop: Any) -> None:
    camera, far = workshop.camera(size_px=FRAME_PX), workshop.camera((100, 0), size_px=FRAME_PX)
    board = filmed(workshop, camera, np.eye(3))
    belt = PreparedFrame(workshop.digitised(20 + np.random.default_rng(0).normal(0, 1.0, FRAME_PX[::-1])))
    black = PreparedFrame(np.zeros(FRAME_PX[::-1], dtype=np.uint8))

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

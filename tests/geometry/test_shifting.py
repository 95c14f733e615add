"""Resampling by runs of shifted pixels: equal to interpolation at the exact positions, and nothing beside the frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vaoi_station.geometry import apply
from vaoi_station.geometry.shifting import BENT, linear_part, shift

UPRIGHT = np.array([[1.0025, -0.0021, -3.3], [0.0021, 0.9975, 2.6], [3e-7, -5e-7, 1.0]])


def waves(x: Any, y: Any) -> Any:
    return 120 + 60 * np.sin(x / 9) + 40 * np.cos(y / 7)


def frame_of(width: int, height: int, channels: int, dtype: Any) -> Any:
    y, x = np.mgrid[:height, :width].astype(float)
    scale = 1 if dtype == np.uint8 else 257
    grey = np.rint(np.stack([waves(x, y) + 5 * n for n in range(channels)], -1) * scale).astype(dtype)
    frame = grey.reshape(height, width * channels)
    frame.flags.writeable = False
    return frame


@pytest.mark.parametrize(("channels", "dtype"), [(1, np.uint8), (3, np.uint8), (1, np.uint16)])
@pytest.mark.parametrize("lean", [1.0, -1.0])
def test_values_are_those_at_the_exact_positions(channels: int, dtype: Any, lean: float) -> None:
    matrix = UPRIGHT.copy()
    matrix[0, 1], matrix[1, 0], matrix[0, 0] = -lean * 0.0021, lean * 0.0021, 1 + lean * 0.0025
    width, height, line = 200, 40, 210 * channels
    out = np.full(line * height + 2 * channels, 7, dtype)
    assert shift(
        frame_of(150, 60, channels, dtype), matrix[None], channels, out, np.array([[2, 210, width, height]]), False
    )[0]
    y, x = np.mgrid[:height, :width].astype(float)
    at = apply(matrix, np.stack([x, y], -1))
    inside = (at[..., 0] > 0) & (at[..., 1] > 0) & (at[..., 0] < 148.9) & (at[..., 1] < 58.9)
    beside = (at[..., 0] < 0) | (at[..., 1] < 0) | (at[..., 0] > 149) | (at[..., 1] > 59)
    found = out[2 * channels :].reshape(height, -1, channels)[:, :width] / (1 if dtype == np.uint8 else 257)
    for n in range(channels):
        assert np.abs(found[..., n] - waves(at[..., 0], at[..., 1]) - 5 * n)[inside].max() < 1.2
    assert inside.any()
    assert (found[beside] == 0).all()
    assert (out[: 2 * channels] == 7).all(), "written before the rectangle"
    assert (out[2 * channels :].reshape(height, -1)[:, width * channels :] == 7).all(), "written beside the rectangle"


def resampled(matrix: Any, whole: bool = False) -> Any:
    """Return a picture of 100 × 100 px, or None if it was not made."""
    out = np.full(100 * 100, 7, np.uint8)
    place = np.array([[0, 100, 100, 100]])
    if not shift(frame_of(150, 130, 1, np.uint8), matrix[None], 1, out, place, whole)[0]:
        assert (out == 7).all()
        return None
    return out.reshape(100, 100)


def test_turned_and_scaled_frames_are_no_shift() -> None:
    assert resampled(np.eye(3)) is not None
    assert resampled(np.array([[0.0, -1, 100], [1, 0, 0], [0, 0, 1]])) is None
    assert resampled(np.diag([1.1, 1.1, 1.0])) is None
    assert resampled(np.array([[1.0, 0, 0], [0, 1, 0], [1e-4, 0, 1]])) is None
    assert resampled(np.array([[1.0, 0, 0], [0, 1, 0], [0, -0.02, 1]])) is None


@pytest.mark.parametrize(("x", "y", "shown"), [(0, 0, True), (49.9, 29.9, True), (50, 0, False), (0, -0.1, False)])
def test_whole_pictures_lie_in_the_frame_with_all_neighbours(x: float, y: float, shown: bool) -> None:
    picture = resampled(np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]]), whole=True)
    assert (picture is not None) == shown
    assert picture is None or (picture > 0).all()


@st.composite
def near_shifts(draw: st.DrawFn) -> tuple[Any, int, int]:
    """Homographies that are almost shifts, with the size of a picture that lies in a frame of 160 × 150 px."""

    def number(most: float) -> float:
        return draw(st.floats(-most, most))

    width, height = draw(st.integers(1, 120)), draw(st.integers(1, 110))
    matrix = np.array([[1.0, 0, 15], [0, 1, 15], [0, 0, 1]])
    matrix[:2] += np.array([[number(0.03), number(0.03), number(4)] for _ in range(2)])
    matrix[2, :2] = number(2e-5), number(2e-5)
    return matrix * draw(st.sampled_from([1.0, -2.5, 1e-3])), width, height


def positions(matrix: Any, width: int, height: int) -> Any:
    y, x = np.mgrid[:height, :width].astype(float)
    return apply(matrix, np.stack([x, y], -1))


@given(near_shifts())
def test_the_linear_part_is_as_near_as_its_bound_states(case: tuple[Any, int, int]) -> None:
    matrix, width, height = case
    f = linear_part(matrix, width, height)
    y, x = np.mgrid[:height, :width]
    linear = np.stack([f.u + f.u_x * x + f.u_y * y, f.v + f.v_x * x + f.v_y * y], -1)
    apart = np.abs(positions(matrix, width, height) - linear).sum(-1).max()
    assert apart <= f.bent + 1e-9
    # The bound is no larger than the matrix demands: at the corner where all terms add up it is reached.
    assert apart >= 0.1 * f.bent or f.bent < BENT


def test_a_homography_with_a_pole_in_the_picture_has_no_linear_part() -> None:
    assert linear_part(np.array([[1.0, 0, 0], [0, 1, 0], [-0.05, 0, 1]]), 60, 60).bent == np.inf


def exact(frame: Any, at: Any) -> Any:
    """Interpolate in double precision."""
    (x, y), (s, t) = np.floor(at).astype(int).transpose(2, 0, 1), (at - np.floor(at)).transpose(2, 0, 1)
    values = frame.astype(float)
    upper, lower = ((1 - s) * values[k, x] + s * values[k, x + 1] for k in (y, y + 1))
    return (1 - t) * upper + t * lower


def checkers(channels: int) -> Any:
    """The steepest edges that pixels can have, in no order; 8 bit."""
    frame = np.random.default_rng(3).choice(np.array([0, 255], np.uint8), (150, 160 * channels))
    frame.flags.writeable = False
    return frame


@given(near_shifts(), st.sampled_from([1, 3]))
@example((np.array([[1.0, 0, 15], [0, 1, 15], [1.49e-5, 0, 1]]), 120, 100), 1)
@example((np.array([[1.0, 0, 15], [0, 1, 15], [1.51e-5, 0, 1]]), 120, 100), 1)
def test_values_stay_within_a_grey_level(case: tuple[Any, int, int], channels: int) -> None:
    (matrix, width, height), frame = case, checkers(channels)
    out = np.full((height + 2) * width * channels, 7, np.uint8)
    done = shift(frame, matrix[None], channels, out, np.array([[width, width, width, height]]), True)[0]
    found = out.reshape(height + 2, width, channels)
    assert (found[[0, -1]] == 7).all(), "written beside the rectangle"
    at = positions(matrix, width, height)
    if done:
        for n in range(channels):
            assert np.abs(found[1:-1, :, n] - exact(frame[:, n::channels], at)).max() <= 1


@pytest.mark.parametrize("beyond", [False, True])
def test_at_the_limit_of_the_bound_values_stay_within_a_grey_level(beyond: bool) -> None:
    width, height = 100, 90
    for lean in (0.0, 0.02, -0.02):
        matrix = np.array([[1.0, lean, 20.3], [-lean, 1, 20.6], [1e-5, 1e-5, 1]])
        low, high = 0.0, 5.0
        for _ in range(60):
            middle = (low + high) / 2
            matrix[2, :2] = middle * 1e-5
            low, high = (middle, high) if linear_part(matrix, width, height).bent < BENT else (low, middle)
        matrix[2, :2] = (high if beyond else low) * 1e-5
        assert (linear_part(matrix, width, height).bent >= BENT) == beyond
        out = np.empty(width * height, np.uint8)
        assert shift(checkers(1), matrix[None], 1, out, np.array([[0, width, width, height]]), True)[0]
        off = out.reshape(height, width) - exact(checkers(1), positions(matrix, width, height))
        assert np.abs(off).max() <= 1


def test_many_rectangles_are_written_as_one_by_one() -> None:
    frame, matrices = frame_of(150, 130, 1, np.uint8), np.stack([np.eye(3), UPRIGHT, np.diag([2.0, 2, 1]), np.eye(3)])
    matrices[1:, 0, 2], matrices[3, 0, 2] = 20.4, 148
    places = np.array([[0, 30, 30, 9], [270, 61, 61, 40], [2710, 20, 20, 20], [3110, 30, 30, 20]])
    out = np.full(3710, 7, np.uint8)
    assert shift(frame, matrices, 1, out, places, True).tolist() == [True, True, False, False]
    assert (out[2710:] == 7).all()
    for matrix, (first, _, width, height) in zip(matrices[:2], places[:2].tolist(), strict=True):
        own = np.empty(width * height, np.uint8)
        shift(frame, matrix[None], 1, own, np.array([[0, width, width, height]]), True)
        assert (own == out[first : first + width * height]).all()


@pytest.mark.parametrize("upside_down", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_pictures_of_hundreds_of_lines_reach_to_the_borders(upside_down: bool, channels: int) -> None:
    """What is read ahead, some lines at a time, lies in the frame, and is in no picture."""
    width, height = 148, 197
    matrix = np.array(
        [[1.003, 0, 0.001], [0, -1.0 if upside_down else 1.0, height - 0.5 if upside_down else 0.5], [0, 0, 1]]
    )
    out = np.empty(width * height * channels, np.uint8)
    frame = frame_of(150, 200, channels, np.uint8)
    assert shift(frame, matrix[None], channels, out, np.array([[0, width, width, height]]), True)[0]
    x, y = positions(matrix, width, height)[..., :2].T
    for n in range(channels):
        off = out.reshape(height, width, channels)[..., n] - waves(x, y).T - 5 * n
        assert np.abs(off).max() < 1.2

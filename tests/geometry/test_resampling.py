"""Resampling: equal to interpolation at the exact positions, black beside the frame, and nothing beside a picture."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry import apply, resampling
from vaoi_station.geometry.resampling import resampled, resampled_in_tiles

WIDTH, HEIGHT = 160, 150


def frame_of(channels: int = 1, dtype: Any = np.uint8) -> Any:
    random = np.random.default_rng(channels)
    frame = random.integers(0, np.iinfo(dtype).max, (HEIGHT, WIDTH, channels), dtype, endpoint=True)
    return frame if channels > 1 else frame[..., 0]


def exact(frame: Any, matrix: Any, width: int, height: int) -> Any:
    """Interpolate in double precision; the frame is black beside its pixels."""
    y, x = np.mgrid[:height, :width].astype(float)
    # Two pixels of black on each side, and places further out moved there.
    at = np.clip(apply(matrix, np.stack([x, y], -1)) + 2, 0, (WIDTH + 2, HEIGHT + 2))
    (i, j), (s, t) = np.floor(at).astype(int).transpose(2, 0, 1), (at - np.floor(at)).transpose(2, 0, 1)
    values = np.pad(frame.reshape(HEIGHT, WIDTH, -1).astype(float), ((2, 2), (2, 2), (0, 0)))
    s, t = s[..., None], t[..., None]
    upper, lower = ((1 - s) * values[k, i] + s * values[k, i + 1] for k in (j, j + 1))
    return ((1 - t) * upper + t * lower).reshape(height, width, *frame.shape[2:])


@st.composite
def near_shifts(draw: st.DrawFn) -> tuple[Any, int, int]:
    """Homographies that are almost shifts, with the size of a picture that may reach over the border of the frame."""

    def number(most: float) -> float:
        return draw(st.floats(-most, most))

    matrix = np.eye(3)
    matrix[:2] += np.array([[number(0.03), number(0.03), number(60)] for _ in range(2)])
    matrix[2, :2] = number(2e-6), number(2e-6)
    return matrix * draw(st.sampled_from([1.0, 2.5, 1e-3])), draw(st.integers(1, 120)), draw(st.integers(1, 110))


@given(near_shifts(), st.sampled_from([1, 3]))
def test_values_are_those_at_the_exact_positions_within_one_grey_level(case: Any, channels: int) -> None:
    matrix, width, height = case
    frame = frame_of(channels)
    [picture] = resampled(frame, matrix[None], np.array([(width, height)]))
    assert picture.dtype == np.uint8
    assert np.abs(picture - exact(frame, matrix, width, height)).max() <= 1


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(np.array([[0.0, -1, 100], [1, 0, 3], [0, 0, 1]]), id="turned"),
        pytest.param(np.diag([0.5, 0.5, 1.0]), id="finer"),
        pytest.param(np.array([[1.0, 0, 0], [0, 1, 0], [1e-4, 0, 1]]), id="bent"),
    ],
)
def test_pictures_that_are_no_shift_are_made_as_well(matrix: Any) -> None:
    # Smooth, because OpenCV computes places in single precision.
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frame = np.rint(120 + 60 * np.sin(x / 9) + 40 * np.cos(y / 7)).astype(np.uint8)
    [picture] = resampled(frame, matrix[None], np.array([(90, 80)]))
    assert np.abs(picture - exact(frame, matrix, 90, 80)).max() <= 1


def test_frames_of_16_bits_are_exact_to_a_grey_level_at_the_far_end_of_the_frame() -> None:
    frame = frame_of(dtype=np.uint16)
    matrix = np.array([[1.002, -0.01, 20.3], [0.01, 0.999, 15.6], [1e-6, 0, 1]])
    [picture] = resampled(frame, matrix[None], np.array([(100, 90)]))
    assert picture.dtype == np.uint16
    assert np.abs(picture - exact(frame, matrix, 100, 90)).max() <= 2


def test_several_pictures_of_one_frame_are_those_made_one_by_one() -> None:
    frame, random = frame_of(), np.random.default_rng(3)
    matrices = np.array([np.eye(3)] * 20)
    matrices[:, :2, 2] = random.uniform(-20, 120, (20, 2))
    matrices[::5, 0, 0] = 1.5
    sizes = random.integers(1, 60, (20, 2))
    found = resampled(frame, matrices, sizes)
    assert [picture.shape for picture in found] == [(h, w) for w, h in sizes.tolist()]
    for picture, matrix, size in zip(found, matrices, sizes, strict=True):
        assert np.array_equal(picture, resampled(frame, matrix[None], size[None])[0])


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("columns", [(0, 64, 100), (0, 90, 100), (0, 7, 12, 100), (0, 101)])
def test_tiles_of_a_picture_leave_their_neighbours_alone(channels: int, columns: tuple[int, ...]) -> None:
    frame = frame_of(channels)
    ends = list(pairwise(columns))
    boxes = np.array([(x0, y0, x1, y1) for y0, y1 in ((0, 31), (31, 80)) for x0, x1 in ends])
    matrices = np.array([[[1.01, 0.02, 10.4 + 0.9 * x], [-0.02, 0.99, 5.7 + y], [0, 0, 1]] for x, y, *_ in boxes])
    picture = resampled_in_tiles(frame, matrices, boxes)
    for (x0, y0, x1, y1), matrix in zip(boxes.tolist(), matrices, strict=True):
        part = exact(frame, matrix, x1 - x0, y1 - y0)
        assert np.abs(picture[y0:y1, x0:x1] - part).max() <= 1


@pytest.mark.parametrize("width", [1, 15, 16, 17, 40, 101])
@pytest.mark.parametrize("columns", [1, 2])
def test_nothing_is_written_beyond_the_values_that_are_there(
    width: int, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One column of tiles overwrote up to 15 bytes behind the picture."""
    write, kept = resampling._write, []

    def guarded(frame: Any, matrices: Any, places: Any, out: Any) -> list[int]:
        behind = np.full(len(out) + 64, 77, np.uint8)
        left = write(frame, matrices, places, behind[: len(out)])
        out[:] = behind[: len(out)]
        kept.append(behind[len(out) :])
        return left

    monkeypatch.setattr(resampling, "_write", guarded)
    boxes = [(x * width, y * 7, (x + 1) * width, (y + 1) * 7) for y in range(3) for x in range(columns)]
    resampled_in_tiles(frame_of(), np.array([np.eye(3)] * len(boxes)), np.array(boxes))
    resampled(frame_of(), np.array([np.eye(3)] * 2), np.array([(width, 7)] * 2))
    assert len(kept) == 2
    assert all((guard == 77).all() for guard in kept)


def test_the_loop_is_compiled_once_for_all_arguments() -> None:
    """A station would wait for the compiler at the first request whose arguments have other types."""
    matrices = np.asfortranarray(np.array([np.eye(3)] * 2))
    for frame in (frame_of(), frame_of(3)):
        for made in (matrices, matrices[:1], np.broadcast_to(np.eye(3), (2, 3, 3))):
            resampled(frame, made, np.array([(20, 30)] * len(made)))
    resampled_in_tiles(frame_of(), matrices, np.array([(0, 0, 40, 20), (0, 20, 40, 50)]))
    compiled: Any = resampling._resample
    assert len(compiled.signatures) == 1

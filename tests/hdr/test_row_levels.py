from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hdr.conftest import StitchedBoard
from vaoi_station.hdr import row_levels as module
from vaoi_station.hdr.row_levels import row_levels
from vaoi_station.photometry import FlatFields, Taken
from vaoi_station.photometry.flat_fields import FlatFieldDocument


def even_fields(board: StitchedBoard) -> FlatFields:
    """Flat fields without any shade: they only state that the array is known."""
    heads = board.recording.head.cameras
    lights = dict.fromkeys(board.recording.head.light(r) for r in range(board.recording.head.rows))
    document = {
        "format": "vaoi-flatfield",
        "version": 1,
        "cameras": [{"width": c.width, "height": c.height, "read": 1.0, "shot": 0.02} for c in heads],
        "fields": [
            {"camera": i, "light": light, "file": f"fields/{i}.tiff", "level": 1.0, "rows": 4}
            for i in range(len(heads))
            for light in lights
        ],
    }
    flats = {(i, light): np.ones((c.height, c.width), np.float32) for i, c in enumerate(heads) for light in lights}
    return FlatFields(FlatFieldDocument.model_validate(document), flats)


def taken_of(board: StitchedBoard) -> dict[tuple[int, int], Taken]:
    """What the frames of a recording were taken with."""
    head = board.recording.head
    every = ((i, j) for i in range(len(head.cameras)) for j in range(head.rows))
    return {(i, j): Taken(head.exposure_us(i, j), head.gain(i, j), head.light(j)) for i, j in every}


def test_flicker_of_single_rows_is_found(small_board: StitchedBoard) -> None:
    b, fields = small_board, even_fields(small_board)
    rows = b.recording.head.rows
    factor = 1 + 0.04 * np.cos(2.1 * np.arange(rows))

    def flickering(camera: int, row: int) -> NDArray[Any] | None:
        frame = b.recording.frame(camera, row)
        return None if frame is None else np.asarray(np.round(frame * 0.7 * factor[row]), np.uint8)

    def steady(camera: int, row: int) -> NDArray[Any] | None:
        frame = b.recording.frame(camera, row)
        return None if frame is None else np.asarray(np.round(frame * 0.7), np.uint8)

    before, after = (
        row_levels(taken_of(b), b.board_type, b.stitch, b.cameras, fields, frame) for frame in (steady, flickering)
    )
    found = after / before
    np.testing.assert_allclose(found / found.mean(), factor / factor.mean(), atol=0.006)
    assert np.log(after).mean() == pytest.approx(0, abs=1e-9)


def test_no_more_pixels_are_read_than_permitted(small_board: StitchedBoard) -> None:
    b, fields, asked = small_board, even_fields(small_board), list[tuple[int, int]]()
    factor = 1 + 0.04 * np.cos(2.1 * np.arange(b.recording.head.rows))

    def levels(most_pixels: float, flicker: float = 1.0) -> NDArray[np.float64]:
        def frame(camera: int, row: int) -> NDArray[Any] | None:
            asked.append((camera, row))
            pixels = b.recording.frame(camera, row)
            return None if pixels is None else np.asarray(np.round(pixels * 0.7 * factor[row] ** flicker), np.uint8)

        asked.clear()
        return row_levels(taken_of(b), b.board_type, b.stitch, b.cameras, fields, frame, most_pixels)

    levels(math.inf)
    frames = Counter(camera for camera, _ in asked)
    size = b.cameras[0].width_px * b.cameras[0].height_px
    assert len(frames) == len(b.cameras) > 1
    for count in range(len(frames)):
        most = sum(n for _, n in frames.most_common(count)) * size + size - 1
        found = levels(most)
        assert len({camera for camera, _ in asked}) == count
        assert len(asked) * size <= most
        if asked:  # without shade in the flat fields, only the difference to steady rows is known
            found /= levels(most, 0.0)
            np.testing.assert_allclose(found / found.mean(), factor / factor.mean(), atol=0.01)
        else:
            np.testing.assert_array_equal(found, 1.0)


def test_rows_that_share_everything_gather_no_error() -> None:
    """Every second row is dark; the others share all of 400 points, with 1 % noise."""
    rows, shared = 240, 400
    rng = np.random.default_rng(6)
    true = np.cumsum(rng.normal(0, 0.002, rows))
    number = np.repeat(np.arange(0, rows, 2), shared)
    points = np.tile(np.arange(shared), rows // 2)
    log = rng.normal(3, 0.5, shared)[points] + true[number] + rng.normal(0, 0.01, len(points))
    seen = np.arange(0, rows, 2)
    error = module._solve(module._Samples(points, number, log), np.arange(rows))[seen] - true[seen]
    assert np.std(error) < 0.001
    assert abs(np.polyfit(np.linspace(-1, 1, len(seen)), error, 1)[0]) < 0.0003

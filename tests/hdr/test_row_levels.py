from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hdr.conftest import StitchedBoard
from vaoi_station.hdr import row_levels as module
from vaoi_station.hdr.row_levels import row_levels
from vaoi_station.photometry import FlatFields, NoiseModel, Taken
from vaoi_station.photometry.flat_fields import FlatFieldDocument
from vaoi_station.photometry.noise import grey_levels
from vaoi_station.photometry.radiance import is_saturated


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


def test_without_flat_fields_or_mapping_all_rows_are_equal(small_board: StitchedBoard) -> None:
    b = small_board
    ones = np.ones(b.recording.head.rows)
    none = FlatFields.none(NoiseModel())
    np.testing.assert_array_equal(
        row_levels(taken_of(b), b.board_type, b.stitch, b.cameras, none, b.recording.frame), ones
    )
    unplaced = b.stitch.model_copy(update={"cad_matrix": None})
    np.testing.assert_array_equal(
        row_levels(taken_of(b), b.board_type, unplaced, b.cameras, even_fields(b), b.recording.frame), ones
    )


@pytest.mark.parametrize("shape", [(90, 120), (90, 120, 3)])
def test_windows_are_those_of_filters_over_the_frame(shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    frame = np.asarray(rng.integers(0, 255, shape), np.uint8)
    frame[20:22, 30] = 255
    x, y = rng.integers(5, 115, 60), rng.integers(5, 85, 60)
    x[:4], y[:4] = (33, 34, 30, 27), (20, 20, 24, 17)
    converted: list[int] = []

    def counted(pixels: NDArray[Any]) -> NDArray[np.float32]:
        converted.append(pixels.shape[0] * pixels.shape[1])
        return grey_levels(pixels)

    monkeypatch.setattr(module, "grey_levels", counted)
    mean, full = module._windows(frame, x, y)
    np.testing.assert_allclose(mean, cv2.blur(grey_levels(frame), (5, 5))[y, x], atol=1e-3)
    saturated = cv2.dilate(is_saturated(frame).astype(np.uint8), np.ones((5, 5), np.uint8))[y, x] > 0
    np.testing.assert_array_equal(full, saturated)
    assert full[:4].tolist() == [True, False, True, True]
    assert converted == [60 * 7 * 7]

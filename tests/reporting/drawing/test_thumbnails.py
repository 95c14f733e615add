"""Thumbnails are small, bright enough, and limited in total size."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.reporting.drawing.thumbnails import NARROWEST_PX, WIDEST_PX, thumbnail, thumbnail_width


def decoded(jpeg: bytes) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("colour", [False, True])
def test_any_frame_becomes_a_small_grey_picture(dtype: type, colour: bool) -> None:
    ramp: NDArray[Any] = np.tile(np.linspace(0, 255 if dtype is np.uint8 else 65535, 640), (480, 1)).astype(dtype)
    small = thumbnail(np.dstack([ramp] * 3) if colour else ramp, 100)
    assert (small.width, small.height) == (100, 75)
    seen = decoded(small.jpeg)
    assert seen.shape == (75, 100)
    assert seen[40, 95] > 200 > seen[40, 5]
    assert small.uri.startswith("data:image/jpeg;base64,/9j/")


def test_dark_frames_are_brightened_and_small_ones_not_enlarged() -> None:
    dark = np.full((30, 40), 12, np.uint8)
    dark[10:20, 10:20] = 50
    small = thumbnail(dark, 100)
    assert (small.width, small.height) == (40, 30)
    assert decoded(small.jpeg)[15, 15] > 200


def test_many_frames_have_small_thumbnails() -> None:
    widths = [thumbnail_width(n) for n in (0, 1, 100, 420, 5000, 10**6)]
    assert widths[0] == WIDEST_PX
    assert widths[-1] == NARROWEST_PX
    assert widths == sorted(widths, reverse=True)

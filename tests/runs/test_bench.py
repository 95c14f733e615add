"""Pictures as files."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest

from vaoi_station.runs.bench import encoded
from vaoi_station.runs.shapes import ImageFormat


@pytest.mark.parametrize("format", ["png", "tiff", "npy"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_exact_formats_keep_every_pixel(format: ImageFormat, dtype: type) -> None:
    image = np.arange(35, dtype=dtype).reshape(5, 7) * 3
    content = encoded(image, format)
    if format == "npy":
        back = np.load(io.BytesIO(content))
    else:
        back = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert back.dtype == dtype
    assert np.array_equal(back, image)


def test_jpeg_is_small_and_close() -> None:
    image = np.full((64, 64), 120, np.uint8)
    back = cv2.imdecode(np.frombuffer(encoded(image, "jpeg"), np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.abs(back.astype(int) - image).max() <= 2

"""Pictures as files."""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.runs.workers.worker_runtime import encoded


def decoded(content: bytes) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize("format", ["png", "tiff", "npy"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_exact_formats_keep_every_pixel(format: ImageFormat, dtype: type) -> None:
    image: NDArray[Any] = np.arange(35, dtype=dtype).reshape(5, 7) * 3
    content = encoded(image, format)
    back = np.load(io.BytesIO(content)) if format == "npy" else decoded(content)
    assert back.dtype == dtype
    assert np.array_equal(back, image)


def test_jpeg_is_small_and_close() -> None:
    image = np.full((64, 64), 120, np.uint8)
    back = decoded(encoded(image, "jpeg"))
    assert np.abs(back.astype(int) - image).max() <= 2

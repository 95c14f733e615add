"""The difference of two temporary images of one component, taken under different lights."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError


def subtract(image: NDArray[Any], other: NDArray[Any], ratio: float = 1.0) -> NDArray[Any]:
    """Return middle grey + (image − ratio · other) / 2, in the pixel type of the image.

    Where both are equally bright, the difference is 128 (8 bit) or 32768 (16 bit); one level of it is two of the image.

    Args:
        image: (h, w) or (h, w, 3), 8 or 16 bit.
        other: the image that is subtracted, of the same shape and type.
        ratio: factor on its grey levels, that makes its exposure that of the first.
    """
    if image.shape != other.shape or image.dtype != other.dtype:
        raise InputError(
            f"images of {image.shape} {image.dtype} and {other.shape} {other.dtype} cannot be subtracted.",
            action="Use cameras of one pixel format.",
        )
    most = int(np.iinfo(image.dtype).max)
    value = (most + 1) / 2 + (image.astype(np.float32) - np.float32(ratio) * other.astype(np.float32)) / 2
    return np.asarray(np.clip(np.rint(value), 0, most), dtype=image.dtype)

"""Merge radiance pictures of the same place, weighted by their noise (paper, section 3.5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.photometry.radiance import Radiance


def merge(stack: Sequence[Radiance]) -> Radiance:
    """Merge pictures of one size, pixel by pixel: the mean of their valid values, weighted by 1/σ².

    The value is NaN, and σ infinite, where no picture is valid.

    Raises:
        InputError: there is no picture, or their sizes differ.
    """
    shapes = {picture.value.shape for picture in stack}
    if len(shapes) != 1:
        found = ", ".join(f"{w}×{h}" for h, w in sorted(shapes)) or "none"
        raise InputError(
            f"radiance pictures of one size can be merged, but there are {len(stack)} of these sizes: {found}.",
            action="Warp all of them to one grid first.",
        )
    shape = shapes.pop()
    total, weights = np.zeros(shape, np.float64), np.zeros(shape, np.float64)
    for picture in stack:
        usable = picture.valid & np.isfinite(picture.value) & (picture.sigma > 0)
        weight = np.where(usable, 1.0 / np.square(picture.sigma, dtype=np.float64), 0.0)
        total += weight * np.where(usable, picture.value, np.float32(0))
        weights += weight
    valid = weights > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        value, sigma = total / weights, 1 / np.sqrt(weights)
    return Radiance(
        np.where(valid, value, np.nan).astype(np.float32), np.where(valid, sigma, np.inf).astype(np.float32), valid
    )

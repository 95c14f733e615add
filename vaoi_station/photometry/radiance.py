"""Linear radiance of one frame, with its standard deviation and the pixels that are valid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.photometry.noise import FULL_SCALE, Floats32, grey_levels

if TYPE_CHECKING:
    from vaoi_station.photometry.flat_fields import FieldMaps

_NEIGHBOURS_PX = 1
"""Pixels around a saturated pixel that are not used: interpolation and the lens mix them with the saturated one."""
_DARKEST_FLAT = 0.02
"""Least value of a flat field that is used; below it, a pixel of the frame sees nothing."""


class Taken(NamedTuple):
    """What a frame was taken with."""

    exposure_us: float
    gain: float = 1.0
    light: str | None = None


@dataclass(frozen=True, eq=False)
class Radiance:
    """Linear radiance of a picture in grey levels (8 bit) per µs at gain 1. Invalid pixels have the value NaN."""

    value: Floats32
    """(h, w)"""
    sigma: Floats32
    """(h, w) standard deviation of `value` by shot and read noise; infinite where it is invalid."""
    valid: NDArray[np.bool_]
    """(h, w); False where the frame is saturated, beside such pixels, and outside the frame."""


def to_radiance(pixels: NDArray[Any], taken: Taken, maps: FieldMaps) -> Radiance:
    """Compute (grey − dark) / (flat · exposure · gain) for all pixels of a frame, or of a part of it.

    Args:
        pixels: (h, w) or (h, w, 3), 8 or 16 bit; colour is converted to luminance.
        taken: exposure, gain and light of the frame.
        maps: flat field, dark level and noise of the camera under this light; of the same part of the frame
            (`FieldMaps.part`).

    Raises:
        InputError: the flat field has another size than the frame.
    """
    if maps.flat is not None and maps.flat.shape != pixels.shape[:2]:
        (h, w), (fh, fw) = pixels.shape[:2], maps.flat.shape
        raise InputError(
            f"the frame has {w}×{h} px, but its flat field has {fw}×{fh} px.",
            action="Use the flat field of this array, or make one with 'vaoi flatfield'.",
        )
    grey = grey_levels(pixels)
    scale = taken.exposure_us * taken.gain
    signal = np.asarray(grey - maps.dark, dtype=np.float32)
    # The variance is that of a local mean: that of the pixel itself would give dark noise more weight than bright.
    variance = maps.noise.variance(cv2.blur(signal, (3, 3)), taken.gain)
    valid = ~is_saturated(pixels)
    if maps.flat is None:
        value, sigma = signal / np.float32(scale), np.sqrt(variance) / np.float32(scale)
    else:
        divisor = maps.flat * np.float32(scale)
        valid &= maps.flat > _DARKEST_FLAT
        with np.errstate(divide="ignore", invalid="ignore"):
            value, sigma = signal / divisor, np.sqrt(variance) / divisor
    return Radiance(
        np.where(valid, value, np.float32(np.nan)).astype(np.float32, copy=False),
        np.where(valid, sigma, np.float32(np.inf)).astype(np.float32, copy=False),
        valid,
    )


def is_saturated(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where a frame (h, w) or (h, w, 3) of 8 or 16 bits is saturated, or touches a saturated pixel: (h, w)."""
    saturated = pixels_at_limit(pixels).astype(np.uint8)
    if saturated.any():
        side = 2 * _NEIGHBOURS_PX + 1
        saturated = np.asarray(cv2.dilate(saturated, np.ones((side, side), np.uint8)))
    return saturated.astype(bool)


def pixels_at_limit(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where a channel of a frame (h, w) or (h, w, 3) of 8 or 16 bits has its largest value: (h, w)."""
    full = FULL_SCALE if pixels.dtype == np.uint8 else 65535
    if pixels.ndim == 3:
        # By OpenCV, because numpy takes ten times as long to reduce an axis of three channels.
        blue, green, red = cv2.split(pixels)
        pixels = np.asarray(cv2.max(cv2.max(blue, green), red))
    return np.asarray(pixels >= full)

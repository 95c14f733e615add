"""Reduce frames to small pictures that are embedded in the report."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import encode_jpeg
from vaoi_station.pixel_formats import eight_bit_grey

WIDEST_PX, NARROWEST_PX = 240, 40
_ALL_PX = 128 * 96 * 600
"""Limit for the pixels of all thumbnails together, so that the report of any run stays within a few MB."""
_QUALITY = 60
_BRIGHTEST = 99.5
"""The percentile that becomes white, so that dark frames are visible too."""


@dataclass(frozen=True)
class Thumbnail:
    """A reduced frame as the bytes of a JPEG, with its width and height in px."""

    jpeg: bytes
    width: int
    height: int

    @property
    def uri(self) -> str:
        """The picture as a data URI."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


def thumbnail_width(frames: int) -> int:
    """Return the width in px of each thumbnail. The more frames a run has, the smaller they are."""
    fair = int((_ALL_PX / max(frames, 1) * 4 / 3) ** 0.5)
    return min(max(fair, NARROWEST_PX), WIDEST_PX)


def thumbnail(pixels: NDArray[Any], width: int) -> Thumbnail:
    """Reduce a frame (h, w) or (h, w, 3), 8 or 16 bit, to a width in px, and brighten it. Never enlarge a frame."""
    grey = eight_bit_grey(pixels)
    h, w = grey.shape
    width = min(width, w)
    size = (width, max(round(h * width / w), 1))
    # INTER_AREA averages all pixels under a thumbnail pixel; other methods skip most of them and alias.
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    # The lower limit of 40 keeps the noise of a black frame black.
    gain = 235 / max(float(np.percentile(small, _BRIGHTEST)), 40.0)
    return Thumbnail(encode_jpeg(cv2.convertScaleAbs(small, alpha=max(gain, 1.0)), _QUALITY), *size)

"""Encode merged pictures: linear as npy or TIFF of 32-bit floats, tone-mapped to 8 bit (for people) as PNG or JPEG."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import encode_jpeg, encode_png, encode_tiff
from vaoi_station.photometry.noise import Floats32

_BRIGHTEST, _DARKEST = 99.8, 0.5
"""Percentiles of radiance that become white, and nearly black."""
_MOST_DECADES = 3.0
_LEAST_RATIO = 2.0
_MIDDLE = 0.42
"""Share of white at which the median of the picture is shown, as far as the limits of the curve permit."""
_BENDS = (0.1, 1e3)


@dataclass(frozen=True)
class ToneCurve:
    """The curve log(1 + bend · x) / log(1 + bend) of x = radiance / white.

    It is linear in dark places and logarithmic in bright ones.
    """

    white: float
    bend: float

    @classmethod
    def of(cls, value: Floats32) -> ToneCurve:
        """Choose the curve of a picture (h, w) by its distribution; pictures of one component share a curve."""
        seen = value[np.isfinite(value)]
        if not len(seen):
            return cls(1.0, 1.0)
        dark, middle, white = (float(v) for v in np.percentile(seen, (_DARKEST, 50, _BRIGHTEST)))
        white = white if white > 0 else 1.0
        middle = min(max(middle, dark, white / 10**_MOST_DECADES), white / _LEAST_RATIO)
        # Bisection on the logarithm: a larger bend shows the median brighter.
        low, high = (math.log(b) for b in _BENDS)
        for _ in range(40):
            bend = math.exp((low + high) / 2)
            shown = math.log1p(bend * middle / white) / math.log1p(bend)
            low, high = ((low + high) / 2, high) if shown < _MIDDLE else (low, (low + high) / 2)
        return cls(white, math.exp((low + high) / 2))


def tone_map(value: Floats32, curve: ToneCurve | None = None) -> NDArray[np.uint8]:
    """Map radiance (h, w) to 8 bit; places without a value are black."""
    curve = curve or ToneCurve.of(value)
    share = np.clip(np.nan_to_num(value, nan=0.0) / np.float32(curve.white), 0, 1)
    shown = np.log1p(np.float32(curve.bend) * share) / np.float32(math.log1p(curve.bend))
    return np.asarray(np.round(shown * 255), dtype=np.uint8)


MergedFormat = Literal["npy", "tiff", "png", "jpeg"]
LINEAR = ("npy", "tiff")
"""The formats that hold radiance and its standard deviation."""


def encode_merged(value: Floats32, form: MergedFormat, curve: ToneCurve | None = None) -> bytes:
    """Encode radiance (h, w), or its standard deviation; `curve` is the tone curve of png and jpeg."""
    match form:
        case "npy":
            buffer = io.BytesIO()
            np.save(buffer, value, allow_pickle=False)
            return buffer.getvalue()
        case "tiff":
            return encode_tiff(value)
        case "png":
            return encode_png(tone_map(value, curve), 3)
        case "jpeg":
            return encode_jpeg(tone_map(value, curve))

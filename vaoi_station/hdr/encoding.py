"""Encode merged pictures: linear as npy or TIFF of 32-bit floats, tone-mapped to 8 bit as PNG or JPEG."""

from __future__ import annotations

import io
from typing import Literal

import numpy as np

from vaoi_station.files.images import encode_jpeg, encode_png, encode_tiff
from vaoi_station.hdr.tone_mapping import ToneCurve, tone_map
from vaoi_station.photometry.noise import Floats32

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

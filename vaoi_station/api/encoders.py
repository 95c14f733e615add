"""Encoding of pictures as PNG, JPEG, TIFF, npy or raw, chosen by `?format=` or Accept.

PNG, TIFF, npy and raw are lossless; JPEG is 8 bit and lossy, for display. Raw is the pixels alone, row by row,
little-endian, described by X-Image-* headers. The colour order is red, green, blue in npy and raw.
"""

from __future__ import annotations

import io
from enum import StrEnum

import numpy as np

from vaoi_station.api.problems import MEDIA_TYPE as PROBLEM
from vaoi_station.api.problems import NotAcceptableError
from vaoi_station.files.images import Image, encode_jpeg, encode_png, encode_tiff


class ImageFormat(StrEnum):
    """Formats in which a picture can be requested."""

    PNG = "png"
    JPEG = "jpeg"
    TIFF = "tiff"
    NPY = "npy"
    RAW = "raw"


MEDIA_TYPES = {
    ImageFormat.PNG: "image/png",
    ImageFormat.JPEG: "image/jpeg",
    ImageFormat.TIFF: "image/tiff",
    ImageFormat.NPY: "application/x-npy",
    ImageFormat.RAW: "application/octet-stream",
}
_NAMES = {"jpg": ImageFormat.JPEG, "tif": ImageFormat.TIFF, **{str(f): f for f in ImageFormat}}


def choose_format(asked: str | None, accept: str | None) -> ImageFormat:
    """Return the format of the reply: `?format=` has precedence over the Accept header. The default is PNG.

    Raises:
        NotAcceptableError: none of the requested formats is available.
    """
    if asked is not None:
        found = _NAMES.get(asked.lower())
        if found is None:
            raise NotAcceptableError(f"format is {asked!r:.40}, but must be one of {', '.join(ImageFormat)}.")
        return found
    # Generated clients often send the type of refusals alone, which says nothing about the picture's format.
    ranges = {media: q for media, q in _accepted(accept or "*/*").items() if media != PROBLEM} or {"*/*": 1.0}

    def quality(image_format: ImageFormat) -> float:
        # RFC 9110, section 12.5.1: the most specific matching range has precedence.
        media = MEDIA_TYPES[image_format]
        patterns = (media, f"{media.partition('/')[0]}/*", "*/*")
        return next((ranges[pattern] for pattern in patterns if pattern in ranges), 0.0)

    # Between formats of equal quality the order of MEDIA_TYPES decides, so that */* gives PNG.
    best = max(MEDIA_TYPES, key=quality)
    if quality(best) <= 0:
        offer = ", ".join(MEDIA_TYPES.values())
        raise NotAcceptableError(f"Accept is {accept!r:.80}, but must allow one of {offer}.")
    return best


def _accepted(header: str) -> dict[str, float]:
    """Parse an Accept header into qualities by media range. An invalid quality counts as 0."""
    ranges = dict[str, float]()
    for part in header.split(","):
        media, *parameters = (p.strip().lower() for p in part.split(";"))
        q = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        try:
            quality = float(q)
        except ValueError:
            quality = 0.0
        ranges.setdefault(media, quality if quality > 0 else 0.0)  # NaN counts as 0
    return ranges


def encode_image(image: Image, image_format: ImageFormat) -> tuple[bytes, dict[str, str]]:
    """Encode a picture (height, width) or (height, width, 3). Return its bytes and its X-Image-* headers."""
    headers = describe(image)
    if image_format is ImageFormat.RAW:
        return _rgb(image).tobytes(), headers
    del headers["X-Image-Stride"]
    if image_format is ImageFormat.JPEG:
        return encode_jpeg(image), headers | {"X-Image-Dtype": "uint8"}
    if image_format is ImageFormat.PNG:
        return encode_png(image), headers
    if image_format is ImageFormat.TIFF:
        return encode_tiff(image), headers
    buffer = io.BytesIO()
    np.save(buffer, _rgb(image), allow_pickle=False)
    return buffer.getvalue(), headers


def _rgb(image: Image) -> Image:
    return np.ascontiguousarray(image if image.ndim == 2 else image[..., ::-1])  # OpenCV has blue, green, red


def describe(image: Image) -> dict[str, str]:
    """Return the X-Image-* headers of a picture. The stride is the distance in bytes between lines of pixels."""
    height, width = image.shape[:2]
    channels = 1 if image.ndim == 2 else image.shape[2]
    return {
        "X-Image-Width": str(width),
        "X-Image-Height": str(height),
        "X-Image-Channels": str(channels),
        "X-Image-Dtype": image.dtype.name,
        "X-Image-Stride": str(width * channels * image.dtype.itemsize),
    }


def raw_from_npy(content: bytes) -> tuple[bytes, dict[str, str]]:
    """Convert an npy file's content to bare pixels, and to the HTTP headers (X-Image-*) that describe their layout."""
    pixels: Image = np.load(io.BytesIO(content), allow_pickle=False)
    return np.ascontiguousarray(pixels).tobytes(), describe(pixels)

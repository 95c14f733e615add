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

    An Accept header that names only the type of refusals, `application/problem+json`, asks for the default.

    Raises:
        NotAcceptableError: none of the requested formats is available.
    """
    if asked is not None:
        found = _NAMES.get(asked.lower())
        if found is None:
            raise NotAcceptableError(f"format is {asked!r:.40}, but must be one of {_offer(names=True)}.")
        return found
    # Generated clients often send the type of refusals alone, which says nothing about the picture's format.
    ranked = [r for r in accepted(accept or "*/*") if r[0] != PROBLEM] or [("*/*", 1.0)]
    # Between formats of equal quality the order of MEDIA_TYPES decides, so that */* gives PNG.
    for wanted in sorted({q for _, q in ranked if q > 0}, reverse=True):
        for image_format, media_type in MEDIA_TYPES.items():
            if quality_of(media_type, ranked) == wanted:
                return image_format
    raise NotAcceptableError(f"Accept is {accept!r:.80}, but must allow one of {_offer(names=False)}.")


def accepted(header: str) -> list[tuple[str, float]]:
    """Parse an Accept header into pairs (media range, quality). An invalid quality counts as 0."""
    ranges = []
    for part in header.split(","):
        media, *parameters = (p.strip().lower() for p in part.split(";"))
        q = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        try:
            ranges.append((media, float(q)))
        except ValueError:
            ranges.append((media, 0.0))
    return ranges


def quality_of(media_type: str, ranges: list[tuple[str, float]]) -> float:
    """Return the quality that the `ranges` of an Accept header give to a media type; 0 if no range covers it."""
    # RFC 9110, section 12.5.1: the most specific matching range has precedence.
    for pattern in (media_type, f"{media_type.partition('/')[0]}/*", "*/*"):
        for media, q in ranges:
            if media == pattern:
                return q
    return 0.0


def encode_image(image: Image, image_format: ImageFormat) -> tuple[bytes, dict[str, str]]:
    """Encode a picture (height, width) or (height, width, 3). Return its bytes and its X-Image-* headers.

    X-Image-Stride is among the headers only if the format is raw.
    """
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


def _rgb(image: Image) -> Image:
    """Return the pixels in the order red, green, blue. OpenCV stores them as blue, green, red."""
    return np.ascontiguousarray(image if image.ndim == 2 else image[..., ::-1])


def _offer(*, names: bool) -> str:
    return ", ".join(map(str, ImageFormat) if names else MEDIA_TYPES.values())


def raw_from_npy(content: bytes) -> tuple[bytes, dict[str, str]]:
    """Convert an npy file's content to bare pixels, and to the HTTP headers (X-Image-*) that describe their layout."""
    pixels: Image = np.load(io.BytesIO(content), allow_pickle=False)
    return np.ascontiguousarray(pixels).tobytes(), describe(pixels)

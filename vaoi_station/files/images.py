"""Frames as image files: PNG or TIFF, 8 or 16 bit, grey or colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files.documents import write_bytes

Image = NDArray[Any]
SUFFIXES = (".png", ".tiff", ".tif")


def read_image(path: Path) -> Image:
    """Read a frame as it was written: (h, w) or (h, w, 3), uint8 or uint16."""
    try:
        content = np.fromfile(path, dtype=np.uint8)
    except FileNotFoundError as error:
        raise NotFoundError(f"{path}: there is no such frame.") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise InputError(f"{path}: is not a picture OpenCV can read; it may have been cut short.")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError.field(path, "pixel type", str(image.dtype), "8 or 16 bit unsigned")
    if image.ndim == 3 and image.shape[2] != 3:
        raise InputError.field(
            path, "number of channels", image.shape[2], "1 (grey) or 3 (colour), without transparency"
        )
    return np.asarray(image)


def encode_png(image: Image, level: int = 1) -> bytes:
    """PNG bytes of a picture; level 1 is the fast end."""
    return encode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])


def encode_tiff(image: Image) -> bytes:
    """Uncompressed TIFF bytes of a picture: large, and read six times as fast as PNG."""
    return encode(".tiff", image, [cv2.IMWRITE_TIFF_COMPRESSION, 1])


def encode_jpeg(image: Image, quality: int = 90) -> bytes:
    """JPEG bytes; 16-bit pictures are brought to 8 bit by their upper byte."""
    eight = image if image.dtype == np.uint8 else np.asarray(image >> 8, dtype=np.uint8)
    return encode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, quality])


def encode(suffix: str, image: Image, options: list[int]) -> bytes:
    """Encoded bytes of a picture in the format of a file suffix."""
    ok, content = cv2.imencode(suffix, image, options)
    if not ok:
        raise InputError(f"a picture of shape {image.shape} and type {image.dtype} cannot be written as {suffix}.")
    return content.tobytes()


def write_image(path: Path, image: Image, level: int = 3) -> None:
    """Write a PNG, or an uncompressed TIFF if the path says so, whole or not at all."""
    write_bytes(path, encode_tiff(image) if path.suffix in (".tiff", ".tif") else encode_png(image, level))

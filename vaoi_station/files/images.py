"""Read and write frames as image files: PNG or TIFF, 8 or 16 bit, grey or colour."""

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
    """Read a frame as array (height, width) or (height, width, 3), uint8 or uint16."""
    try:
        # Read with numpy and decode from memory: cv2.imread returns None for an absent as well as for a broken file.
        content = np.fromfile(path, dtype=np.uint8)
    except FileNotFoundError as error:
        raise NotFoundError(f"{path}: there is no such frame.") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise InputError(f"{path}: is not a picture that OpenCV can read; it may be incomplete.")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError.field(path, "pixel type", str(image.dtype), "8 or 16 bit unsigned")
    if image.ndim == 3 and image.shape[2] != 3:
        raise InputError.field(
            path, "number of channels", image.shape[2], "1 (grey) or 3 (colour), without transparency"
        )
    return np.asarray(image)


def encode_png(image: Image, level: int = 1) -> bytes:
    """Encode an image as PNG; level 1 is the fastest."""
    return encode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])


def encode_tiff(image: Image) -> bytes:
    """Encode an image as uncompressed TIFF, which is large but is read six times as fast as PNG."""
    return encode(".tiff", image, [cv2.IMWRITE_TIFF_COMPRESSION, 1])


def encode_jpeg(image: Image, quality: int = 90) -> bytes:
    """Encode an image as JPEG; 16-bit images are reduced to their upper byte."""
    eight = image if image.dtype == np.uint8 else np.asarray(image >> 8, dtype=np.uint8)
    return encode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, quality])


def encode(suffix: str, image: Image, options: list[int]) -> bytes:
    """Encode an image in the format of a file suffix; `options` are parameters of cv2.imencode."""
    ok, content = cv2.imencode(suffix, image, options)
    if not ok:
        raise InputError(f"a picture of shape {image.shape} and type {image.dtype} cannot be written as {suffix}.")
    return content.tobytes()


def write_image(path: Path, image: Image, level: int = 3) -> None:
    """Write a PNG, or an uncompressed TIFF for the suffix .tiff or .tif, atomically."""
    write_bytes(path, encode_tiff(image) if path.suffix in (".tiff", ".tif") else encode_png(image, level))

"""Read and write frames as image files: PNG or TIFF, 8 or 16 bit, grey or colour."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import DeviceError, GoneError, InputError, NotFoundError
from vaoi_station.files.documents import write_bytes

Image = NDArray[Any]
_PNG = b"\x89PNG\r\n\x1a\n"
_DECODED = (_PNG, b"II*\0", b"MM\0*", b"\xff\xd8\xff")
"""First bytes of PNG, TIFF and JPEG. OpenCV selects a decoder by content, not by name: without this list a file of
another origin could reach the decoders of all its other formats."""
# For a damaged file, OpenCV writes a warning to stderr, in addition to the refusal by this module. The level of such
# warnings applies to the whole process. It is set only once, because threads that change it would disturb one another.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
SUFFIXES = (".png", ".tiff", ".tif")
_AVERAGE = 64
"""PNG_FILTER_AVG of libpng."""
# Noise repeats no text that a search for matches could find: half the time, and 8 % less. Level 1 comes first, because
# OpenCV chooses the strategy anew when it reads the level. In colour, the search finds what channels have in common.
_FAST_GREY = [
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_FILTER, _AVERAGE),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE),
]


def read_image(path: Path) -> Image:
    """Read a frame as array (height, width) or (height, width, 3), uint8 or uint16."""
    try:
        # Read with numpy and decode from memory: cv2.imread returns None for an absent as well as for a broken file.
        content = np.fromfile(path, dtype=np.uint8)
    except FileNotFoundError as error:
        raise NotFoundError(f"{path}: there is no such frame.") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    image = decode(content)
    if image is None:
        raise InputError(f"{path}: is not a picture that OpenCV can read; it may be incomplete.")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError.field(path, "pixel type", str(image.dtype), "8 or 16 bit unsigned")
    if image.ndim == 3 and image.shape[2] != 3:
        raise InputError.field(
            path, "number of channels", image.shape[2], "1 (grey) or 3 (colour), without transparency"
        )
    return np.asarray(image)


def read_kept_image(path: Path) -> Image:
    """Read a frame that this station has kept on disk.

    Raises:
        GoneError: the file was deleted; the quota may do so at any time.
        DeviceError: the file is damaged.
    """
    try:
        return read_image(path)
    except NotFoundError as error:
        raise GoneError(
            f"{path}: the recording was deleted, because its space was needed.",
            action="Pin runs whose frames are needed for long, or raise [keep] recordings_gb.",
            code="frames-gone",
        ) from error
    except InputError as error:
        raise DeviceError(error.message, action="Check the disk: a kept recording is damaged.") from error


def decode(content: bytes | NDArray[np.uint8]) -> Image | None:
    """Decode a PNG, TIFF or JPEG in memory; None if OpenCV cannot decode it. OpenCV itself writes nothing to stderr."""
    data = np.frombuffer(content, np.uint8) if isinstance(content, bytes) else content
    if not bytes(data[: len(_PNG)]).startswith(_DECODED):
        return None
    # libpng writes to stderr directly for damaged data, so that a PNG is checked before libpng receives it.
    if not data.size or _is_damaged_png(data.data):
        return None
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:  # the header declares an impossible size
        image = None
    return None if image is None else np.asarray(image)


def _is_damaged_png(content: memoryview) -> bool:
    """Return whether a PNG is incomplete, or a chunk differs from its check sum; False for other formats."""
    if content[: len(_PNG)] != _PNG:
        return False
    at = len(_PNG)
    while at + 12 <= len(content):
        length, kind = int.from_bytes(content[at : at + 4]), bytes(content[at + 4 : at + 8])
        end = at + 8 + length
        if zlib.crc32(content[at + 4 : end]) != int.from_bytes(content[end : end + 4]):
            return True
        if kind == b"IEND":
            return False
        at = end + 4
    return True


def encode_png(image: Image, level: int | None = None) -> bytes:
    """Encode an image as PNG with a level of compression; without one, in the fastest way."""
    if level is None and image.ndim == 2:
        return encode(".png", image, _FAST_GREY)
    return encode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level or 1])


def encode_tiff(image: Image) -> bytes:
    """Encode an image as uncompressed TIFF, which is large but is read six times as fast as PNG."""
    return encode(".tiff", image, [cv2.IMWRITE_TIFF_COMPRESSION, 1])


def encode_jpeg(image: Image, quality: int = 90) -> bytes:
    """Encode an image as JPEG; 16-bit images are reduced to their upper byte.

    Raises:
        InputError: `quality` is not 1 to 100. OpenCV would use the nearest valid value without an error.
    """
    if not 1 <= quality <= 100:
        raise InputError.field("JPEG", "quality", quality, "a whole number from 1 to 100")
    eight = image if image.dtype == np.uint8 else np.asarray(image >> 8, dtype=np.uint8)
    return encode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, quality])


def narrowed_jpeg(content: bytes, width: int) -> bytes:
    """Return a JPEG of this width of the picture in a file, or the file as it is if the picture is no wider.

    Raises:
        DeviceError: the file cannot be decoded.
    """
    image = decode(content)
    if image is None:
        raise DeviceError("the file of a picture is damaged.", action="Check the disk.")
    height, present = image.shape[:2]
    if present <= width:
        return content
    # The mean over areas: samples between pixels would miss traces and letters that are thinner than a pixel here.
    size = width, max(1, round(height * width / present))
    return encode_jpeg(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)), 80)


def encode(suffix: str, image: Image, options: list[int]) -> bytes:
    """Encode an image in the format of a file suffix; `options` are parameters of cv2.imencode."""
    ok, content = cv2.imencode(suffix, image, options)
    if not ok:
        raise InputError(f"a picture of shape {image.shape} and type {image.dtype} cannot be written as {suffix}.")
    return content.tobytes()


def write_image(path: Path, image: Image, level: int = 3) -> None:
    """Write a PNG, or an uncompressed TIFF for the suffix .tiff or .tif, atomically."""
    content = encode_tiff(image) if path.suffix in (".tiff", ".tif") else encode_png(image, level)
    # A recording has hundreds of them; `new_directory` waits for all at its end.
    write_bytes(path, content, durable=False)

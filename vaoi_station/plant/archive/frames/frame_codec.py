"""The stored form of a frame: 8 or 16 bit, grey, Bayer or colour, bit for bit."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import Image
from vaoi_station.plant.archive.frames.former_planes import decode_former_plane
from vaoi_station.plant.archive.frames.plane_codec import decode_plane, encode_plane

_MAGIC = b"VFR3"
_FORMER = {b"VFR1": 1, b"VFR2": 2}
"""Magic and version of frames that can be read and are no longer written."""
_HEAD = struct.Struct("<4sBBIIII")
"""Magic, bytes per sample, channels, height, width, CRC-32 of the pixels, bytes of the list of levels."""
_MOST_PIXELS = 1 << 30
_SAMPLED = 16
"""Every row with this distance decides how far neighbours are."""


def encode_frame(image: Image) -> bytes:
    """Encode a frame (height, width) or (height, width, 3), uint8 or uint16."""
    image = np.ascontiguousarray(image)
    channels = 1 if image.ndim == 2 else image.shape[2]
    levels = _levels(image)
    ranked = image if levels is None else _rank(image, levels)
    listed = b"" if levels is None else zlib.compress(np.diff(levels, prepend=np.uint16(0)).astype("<u2").tobytes(), 6)
    parts = [encode_plane(plane, _step(plane)) for plane in _planes(ranked)]
    head = _HEAD.pack(_MAGIC, image.itemsize, channels, *image.shape[:2], zlib.crc32(image.data), len(listed))
    return b"".join((head, listed, *(len(part).to_bytes(4, "little") + part for part in parts)))


def decode_frame(content: bytes) -> Image:
    """Decode a frame; ValueError if the content is no frame, or its pixels do not match their checksum."""
    if len(content) < _HEAD.size:
        raise ValueError("too short for a frame")
    magic, size, channels, height, width, checksum, listed = _HEAD.unpack_from(content)
    if magic[:3] == _MAGIC[:3] and magic not in (_MAGIC, *_FORMER):
        raise ValueError(
            f"the frame has version {magic[3:].decode(errors='replace')}, this software reads {_MAGIC[3:].decode()}"
        )
    if (
        magic[:3] != _MAGIC[:3]
        or size not in (1, 2)
        or channels not in (1, 3)
        or not 0 < height * width <= _MOST_PIXELS
    ):
        raise ValueError("not a frame of this format")
    at = _HEAD.size + listed
    former = _FORMER.get(magic)
    planes = []
    for _ in range(channels):
        end = at + 4 + int.from_bytes(content[at : at + 4], "little")
        part, shape = content[at + 4 : end], (height, width)
        planes.append(decode_plane(part, shape) if former is None else decode_former_plane(part, shape, former))
        at = end
    image = _joined(planes, np.uint8 if size == 1 else np.uint16)
    if listed:
        levels = _unpacked_levels(content[_HEAD.size : _HEAD.size + listed])
        image = levels[np.minimum(image, len(levels) - 1)]
    image = np.ascontiguousarray(image)
    if zlib.crc32(image.data) != checksum:
        raise ValueError("the pixels do not match their checksum")
    return image


def _levels(image: Image) -> NDArray[np.uint16] | None:
    """Return the values of a 16-bit frame that occur, if they are less than half of those up to the largest.

    A camera of 12 bits whose values were scaled to 16 bits has 4096 of them.
    """
    if image.dtype == np.uint8:
        return None
    there = np.bincount(image.reshape(-1), minlength=1) > 0
    levels = np.flatnonzero(there).astype(np.uint16)
    return levels if 2 * len(levels) < len(there) else None


def _unpacked_levels(content: bytes) -> NDArray[np.uint16]:
    try:
        steps = np.frombuffer(zlib.decompress(content), "<u2")
    except zlib.error as error:
        raise ValueError("the list of levels is damaged") from error
    if not len(steps):
        raise ValueError("the list of levels is empty")
    return np.cumsum(steps, dtype=np.uint16)


def _rank(image: Image, levels: NDArray[np.uint16]) -> Image:
    ranks = np.zeros(1 << 16, np.uint16)
    ranks[levels] = np.arange(len(levels), dtype=np.uint16)
    return ranks[image]


def _planes(image: Image) -> list[Image]:
    """Return the planes of a frame: green, and how far blue and red lie above it, about the middle of the scale."""
    if image.ndim == 2:
        return [image]
    blue, green, red = (image[..., k] for k in range(3))
    half = image.dtype.type(1 << (8 * image.itemsize - 1))
    # The differences wrap around within the type, and so do the sums that undo them.
    return [green, blue - green + half, red - green + half]


def _joined(planes: list[NDArray[np.uint16]], kind: type[np.uint8] | type[np.uint16]) -> Image:
    """Undo `_planes`."""
    typed: list[Image] = [plane.astype(kind) for plane in planes]
    if len(typed) == 1:
        return typed[0]
    half = np.array(1 << (8 * np.dtype(kind).itemsize - 1), kind)
    green, blue, red = typed
    return np.stack([blue + green - half, green, red + green - half], -1)


def _step(plane: Image) -> int:
    """Return the distance of the neighbours that are most alike: 2 for frames with a Bayer filter."""
    rows = plane[::_SAMPLED].astype(np.int32)
    unlike = [int(np.abs(rows[:, step:] - rows[:, :-step]).sum()) / max(rows[:, step:].size, 1) for step in (1, 2)]
    return 1 if unlike[0] <= 1.25 * unlike[1] else 2

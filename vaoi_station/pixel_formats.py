"""Pixel formats of machine vision cameras: memory layout of the bytes, and conversion to pictures.

Names, numbers and layouts follow the Pixel Format Naming Convention (PFNC 2) of EMVA and A3; the *Packed* formats are
older and specific to GigE Vision. Frames stay in the ring as the camera sends them and are unpacked when they are read.
Pictures of more than 8 bits are scaled to 16 bits, 0 to 65535, so that white has the same value at every bit depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

Packing = Literal["bytes", "words", "packed", "p"]
"""How samples lie in memory.

`bytes`: one byte each. `words`: the lower bits of a little-endian 16-bit word. `packed`: GigE Vision packing, two
samples in three bytes. `p`: consecutive bits, least significant first.
"""
PixelFormatName = Literal[
    "Mono8", "Mono10", "Mono10Packed", "Mono10p", "Mono12", "Mono12Packed", "Mono12p", "Mono14", "Mono16",
    "BayerGR8", "BayerRG8", "BayerGB8", "BayerBG8",
    "BayerGR10", "BayerRG10", "BayerGB10", "BayerBG10",
    "BayerGR10Packed", "BayerRG10Packed", "BayerGB10Packed", "BayerBG10Packed",
    "BayerGR10p", "BayerRG10p", "BayerGB10p", "BayerBG10p",
    "BayerGR12", "BayerRG12", "BayerGB12", "BayerBG12",
    "BayerGR12Packed", "BayerRG12Packed", "BayerGB12Packed", "BayerBG12Packed",
    "BayerGR12p", "BayerRG12p", "BayerGB12p", "BayerBG12p",
    "BayerGR16", "BayerRG16", "BayerGB16", "BayerBG16",
]  # fmt: skip
_CODES = {
    "Mono8": 0x01080001, "Mono10": 0x01100003, "Mono10Packed": 0x010C0004, "Mono10p": 0x010A0046,
    "Mono12": 0x01100005, "Mono12Packed": 0x010C0006, "Mono12p": 0x010C0047, "Mono14": 0x01100025, "Mono16": 0x01100007,
    "BayerGR8": 0x01080008, "BayerRG8": 0x01080009, "BayerGB8": 0x0108000A, "BayerBG8": 0x0108000B,
    "BayerGR10": 0x0110000C, "BayerRG10": 0x0110000D, "BayerGB10": 0x0110000E, "BayerBG10": 0x0110000F,
    "BayerGR10Packed": 0x010C0026, "BayerRG10Packed": 0x010C0027,
    "BayerGB10Packed": 0x010C0028, "BayerBG10Packed": 0x010C0029,
    "BayerGR10p": 0x010A0056, "BayerRG10p": 0x010A0058, "BayerGB10p": 0x010A0054, "BayerBG10p": 0x010A0052,
    "BayerGR12": 0x01100010, "BayerRG12": 0x01100011, "BayerGB12": 0x01100012, "BayerBG12": 0x01100013,
    "BayerGR12Packed": 0x010C002A, "BayerRG12Packed": 0x010C002B,
    "BayerGB12Packed": 0x010C002C, "BayerBG12Packed": 0x010C002D,
    "BayerGR12p": 0x010C0057, "BayerRG12p": 0x010C0059, "BayerGB12p": 0x010C0055, "BayerBG12p": 0x010C0053,
    "BayerGR16": 0x0110002E, "BayerRG16": 0x0110002F, "BayerGB16": 0x01100030, "BayerBG16": 0x01100031,
}  # fmt: skip
# OpenCV's two-letter constants name the pattern from pixel (1, 1) on, PFNC from pixel (0, 0) on. The four-letter
# constants (BayerRGGB and so on) start at pixel (0, 0) as well.
_MOSAICS = {
    "RG": cv2.COLOR_BayerRGGB2BGR,
    "GR": cv2.COLOR_BayerGRBG2BGR,
    "GB": cv2.COLOR_BayerGBRG2BGR,
    "BG": cv2.COLOR_BayerBGGR2BGR,
}


@dataclass(frozen=True)
class PixelFormat:
    """One pixel format of the convention."""

    name: str
    code: int
    """PFNC number; its bits 16 to 23 hold the bits per pixel in memory."""
    bits: int
    """Number of bits of one sample of a pixel."""
    packing: Packing
    mosaic: str
    """Colours of the first two pixels under a Bayer filter; empty for grey cameras."""

    @property
    def bits_per_pixel(self) -> int:
        """Bits per pixel in memory, packing included."""
        return self.code >> 16 & 0xFF

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes per pixel in memory; 0 where a pixel is not a whole number of bytes."""
        return 0 if self.bits_per_pixel % 8 else self.bits_per_pixel // 8

    @property
    def in_place(self) -> bool:
        """Whether the frame's bytes are the picture without conversion."""
        return not self.mosaic and self.bits in (8, 16)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type (numpy) of the samples of the picture."""
        return np.dtype("u1") if self.bits == 8 else np.dtype("<u2")

    def nbytes(self, width: int, height: int) -> int:
        """Return the size of a frame in bytes; lines are not padded."""
        # Ceiling division: a packed frame may end in a partly used byte.
        return -(-width * height * self.bits_per_pixel // 8)


def _format(name: str) -> PixelFormat:
    colour = name.startswith("Bayer")
    depth = name[7:] if colour else name[4:]
    bits = int(depth.removesuffix("Packed").removesuffix("p"))
    packing: Packing = (
        "packed" if depth.endswith("Packed") else "p" if depth.endswith("p") else "bytes" if bits == 8 else "words"
    )
    return PixelFormat(name, _CODES[name], bits, packing, name[5:7] if colour else "")


PIXEL_FORMATS = {name: _format(name) for name in get_args(PixelFormatName)}
"""All supported formats by name."""


def picture(frame: NDArray[np.uint8], width: int, height: int, pixel_format: PixelFormat) -> NDArray[Any]:
    """Convert a frame's bytes, (n,) uint8, to a picture: uint8, or uint16 at full scale.

    It is (height, width) grey, or (height, width, 3) blue, green, red under a Bayer filter, interpolated bilinearly;
    a view of the bytes themselves where the format permits (`in_place`).
    """
    if pixel_format.in_place:
        return frame.view(pixel_format.dtype).reshape(height, width)
    values = samples(frame, width * height, pixel_format).reshape(height, width)
    if pixel_format.bits not in (8, 16):
        values = to_full_scale(values, pixel_format.bits)
    if pixel_format.mosaic:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(values), _MOSAICS[pixel_format.mosaic]))
    return values


def to_full_scale(values: NDArray[Any], bits: int) -> NDArray[Any]:
    """Scale uint16 values from 0 … 2^bits − 1, 8 ≤ bits ≤ 16, to 0 … 65535."""
    room = 16 - bits
    # Repeat the upper bits below the lower ones, so that full scale maps to 65535 exactly and 0 to 0.
    return np.asarray(values << room | values >> bits - room, dtype=np.uint16) if room else values


def eight_bit_grey(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the 8-bit luminance (h, w) of a picture (h, w) or (h, w, 3); an 8-bit grey picture is not changed.

    Pictures of 16 bits are at full scale (`picture`, `Recording.frame`). The scale never depends on the pixels:
    thresholds in grey levels then mean the same in every frame, for stitching, calibration and viewing alike.
    """
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    return grey if grey.dtype == np.uint8 else np.asarray(grey >> 8, dtype=np.uint8)


def samples(frame: NDArray[np.uint8], count: int, pixel_format: PixelFormat) -> NDArray[Any]:
    """Unpack the camera's sample values, (count,): uint8 in place, or a new uint16 array, 0 … 2^bits − 1."""
    bits = pixel_format.bits
    if pixel_format.packing == "bytes":
        return frame
    if pixel_format.packing == "words":
        # Copied, because the caller scales the values and the ring is read-only.
        return frame.view("<u2").copy()
    # 10p packs 4 samples into 5 bytes; every other packed format has 2 samples in 3 bytes.
    pixels, size = (4, 5) if (bits, pixel_format.packing) == (10, "p") else (2, 3)
    groups = -(-count // pixels)
    whole = frame if len(frame) == groups * size else np.pad(frame, (0, groups * size - len(frame)))
    b = whole.reshape(groups, size).T.astype(np.uint16)
    out = np.empty((groups, pixels), np.uint16)
    if pixel_format.packing == "packed":
        # Bytes 0 and 2 hold the upper 8 bits of two samples, byte 1 the lower bits of both.
        low = bits - 8
        mask = (1 << low) - 1
        out[:, 0] = b[0] << low | b[1] & mask
        out[:, 1] = b[2] << low | b[1] >> 4 & mask
    elif bits == 12:
        out[:, 0] = b[0] | (b[1] & 0xF) << 8
        out[:, 1] = b[1] >> 4 | b[2] << 4
    else:
        out[:, 0] = b[0] | (b[1] & 0x3) << 8
        out[:, 1] = b[1] >> 2 | (b[2] & 0xF) << 6
        out[:, 2] = b[2] >> 4 | (b[3] & 0x3F) << 4
        out[:, 3] = b[3] >> 6 | b[4] << 2
    return out.reshape(-1)[:count]

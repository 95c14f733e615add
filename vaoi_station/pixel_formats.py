"""Pixel formats of machine vision cameras: what their bytes mean, and how they become pictures.

Names, numbers and layouts are those of the Pixel Format Naming Convention (PFNC 2) of EMVA and A3; the *Packed* ones
are GigE Vision's own and older. Frames stay in memory as the camera sends them; whoever looks unpacks. All pictures
of more than 8 bits get the full scale of 16, from 0 to 65535: white is white whatever the camera's depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

Packing = Literal["bytes", "words", "packed", "p"]
"""A sample is a byte, a little-endian word whose lower bits it fills, 12 bits of GigE Vision's packing, or a run of
bits from the least significant one on."""
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
_MOSAICS = {
    "RG": cv2.COLOR_BayerRGGB2BGR,
    "GR": cv2.COLOR_BayerGRBG2BGR,
    "GB": cv2.COLOR_BayerGBRG2BGR,
    "BG": cv2.COLOR_BayerBGGR2BGR,
}


@dataclass(frozen=True)
class PixelFormat:
    """One format of the convention."""

    name: str
    code: int
    """Its number; bits 16 to 23 are the bits a pixel takes in memory."""
    bits: int
    """Of one sample."""
    packing: Packing
    mosaic: str
    """Colours of the first two pixels under a Bayer filter; empty without one."""

    @property
    def bits_per_pixel(self) -> int:
        """In memory, packing included."""
        return self.code >> 16 & 0xFF

    @property
    def bytes_per_pixel(self) -> int:
        """0 where pixels are not whole bytes."""
        return 0 if self.bits_per_pixel % 8 else self.bits_per_pixel // 8

    @property
    def in_place(self) -> bool:
        """Whether the bytes are the picture already."""
        return not self.mosaic and self.bits in (8, 16)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the picture's samples."""
        return np.dtype("u1") if self.bits == 8 else np.dtype("<u2")

    def nbytes(self, width: int, height: int) -> int:
        """Size of a frame; lines are not padded."""
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
"""By name."""


def picture(frame: NDArray[np.uint8], width: int, height: int, pixel_format: PixelFormat) -> NDArray[Any]:
    """What a frame shows.

    Args:
        frame: its bytes, (n,) uint8, n as `nbytes` says.
        width: in pixels.
        height: in pixels.
        pixel_format: of the bytes.

    Returns:
        (height, width) grey, or (height, width, 3) blue, green, red under a Bayer filter (interpolated bilinearly);
        uint8, or uint16 at full scale. A view of the bytes themselves where the format permits (`in_place`).
    """
    if pixel_format.in_place:
        return frame.view(pixel_format.dtype).reshape(height, width)
    values = samples(frame, width * height, pixel_format).reshape(height, width)
    if pixel_format.bits not in (8, 16):
        room = 16 - pixel_format.bits
        values = values << room | values >> pixel_format.bits - room  # the upper bits once more: white becomes 65535
    if pixel_format.mosaic:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(values), _MOSAICS[pixel_format.mosaic]))
    return values


def samples(frame: NDArray[np.uint8], count: int, pixel_format: PixelFormat) -> NDArray[Any]:
    """The camera's own numbers, (count,): uint8 in place, or a fresh array of uint16, 0 … 2^bits − 1."""
    bits = pixel_format.bits
    if pixel_format.packing == "bytes":
        return frame
    if pixel_format.packing == "words":
        return frame.view("<u2").copy()
    pixels, size = (4, 5) if (bits, pixel_format.packing) == (10, "p") else (2, 3)
    groups = -(-count // pixels)
    whole = frame if len(frame) == groups * size else np.pad(frame, (0, groups * size - len(frame)))
    b = whole.reshape(groups, size).T.astype(np.uint16)
    out = np.empty((groups, pixels), np.uint16)
    if pixel_format.packing == "packed":  # upper bits of two samples, the lower ones of both in the byte between
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

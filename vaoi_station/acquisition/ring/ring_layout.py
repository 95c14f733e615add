"""The layout of the ring's file: pure arithmetic, documented for C and C# in `docs/internals/ring.md`.

A **bay** is the memory of one run: for every camera as many slots as the longest board needs. A **slot** is the memory
of one frame and begins on a page boundary. All numbers are little-endian.

    header page │ camera table │ bay table │ slot table │ bay 0: camera 0: slot 0, slot 1 … │ bay 1 …
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.pixel_formats import PIXEL_FORMATS, PixelFormat

MAGIC = b"VAOIRING"
LAYOUT_VERSION = 1
PAGE_BYTES = 4096

BUILDING, IN_USE, CLOSED = 0, 1, 2
"""States of the ring's file, as its header states them."""
EMPTY, OK, INCOMPLETE = 0, 1, 2
"""States of a slot, as the slot table states them."""
NO_ROW = 0xFFFFFFFF
"""Row number in the slot table for a slot that holds no frame."""

# Offsets are explicit: other programs take them from ring.md, so no compiler and no NumPy alignment may move a field.
HEADER = np.dtype(
    {
        "names": [
            "magic", "layout_version", "header_bytes", "file_bytes", "generation", "owner_pid", "state",
            "owner_start_ticks", "bays", "cameras", "slots_per_camera", "page_bytes", "slot_bytes",
            "camera_table", "bay_table", "slot_table", "first_slot",
        ],
        "formats": ["S8", "<u4", "<u4", "<u8", "<u8", "<u4", "<u4", "<u8", *["<u4"] * 4, *["<u8"] * 5],
        "offsets": [0, 8, 12, 16, 24, 32, 36, 40, 48, 52, 56, 60, 64, 72, 80, 88, 96],
        "itemsize": PAGE_BYTES,
    }
)  # fmt: skip
CAMERA_RECORD = np.dtype([("width", "<u4"), ("height", "<u4"), ("pixel_format", "<u4"), ("bytes_per_pixel", "<u4")])
BAY_RECORD = np.dtype([("generation", "<u8"), ("reserved", "<u8")])
SLOT_RECORD = np.dtype(
    [("generation", "<u8"), ("state", "<u4"), ("row", "<u4"), ("frame_id", "<u8"), ("reserved", "<u8")]
)


@dataclass(frozen=True)
class FrameShape:
    """Size and pixel format of the frames of one camera."""

    width: int
    height: int
    pixel_format: str

    def __post_init__(self) -> None:
        if self.pixel_format not in PIXEL_FORMATS:
            raise InputError.field("ring", "pixel_format", self.pixel_format, f"one of {', '.join(PIXEL_FORMATS)}")

    @property
    def format(self) -> PixelFormat:
        """The pixel format, which defines how the bytes of a frame are converted to a picture."""
        return PIXEL_FORMATS[self.pixel_format]

    @property
    def nbytes(self) -> int:
        """Size of the pixels of one frame, bytes."""
        return self.format.nbytes(self.width, self.height)


@dataclass(frozen=True)
class RingLayout:
    """The layout of a ring's file: counts and frame sizes, and all offsets computed from them."""

    bays: int
    slots_per_camera: int
    frames: tuple[FrameShape, ...]
    """Size and pixel format of every camera's frames."""
    room_bytes: int = 0
    """Bytes behind the largest frame that every slot has as well, whole pages: cameras write chunk data there."""

    def __post_init__(self) -> None:
        for key in ("bays", "slots_per_camera"):
            if getattr(self, key) < 1:
                raise InputError.field("ring", key, getattr(self, key), "at least 1")
        if not self.frames:
            raise InputError("ring: there is no camera; the ring holds the frames of at least one.")

    @classmethod
    def of(cls, config: StationConfig) -> RingLayout:
        """Return a station's layout: `ring.runs` bays, each with slots for the longest board and the spare rows."""
        shapes = tuple(FrameShape(c.width, c.height, c.pixel_format) for c in config.cameras)
        room_bytes = _pages(max(c.chunk_room_bytes for c in config.cameras))
        return cls(config.ring.runs, config.rows_per_run, shapes, room_bytes)

    @property
    def cameras(self) -> int:
        """Count of cameras (n in the paper)."""
        return len(self.frames)

    @property
    def slots_per_bay(self) -> int:
        """Count of slots in one bay, for all cameras together."""
        return self.cameras * self.slots_per_camera

    @property
    def slots(self) -> int:
        """Count of slots in the whole ring."""
        return self.bays * self.slots_per_bay

    @cached_property
    def slot_bytes(self) -> int:
        """Distance between the starts of two slots, bytes: the largest frame in whole pages, and the room behind it."""
        return _pages(max(f.nbytes for f in self.frames)) + self.room_bytes

    @property
    def camera_table(self) -> int:
        """Offset of the camera table in the file, bytes."""
        return PAGE_BYTES

    @property
    def bay_table(self) -> int:
        """Offset of the bay table in the file, bytes."""
        return self.camera_table + _pages(self.cameras * CAMERA_RECORD.itemsize)

    @property
    def slot_table(self) -> int:
        """Offset of the slot table in the file, bytes."""
        return self.bay_table + _pages(self.bays * BAY_RECORD.itemsize)

    @cached_property
    def first_slot(self) -> int:
        """Offset of slot 0 in the file, bytes."""
        return self.slot_table + _pages(self.slots * SLOT_RECORD.itemsize)

    @property
    def file_bytes(self) -> int:
        """Size of the ring's file, bytes."""
        return self.first_slot + self.slots * self.slot_bytes

    def slot(self, bay: int, camera: int, k: int) -> int:
        """Return the number of the slot with index k, among the slots of one camera in one bay."""
        limits = (("bay", bay, self.bays), ("camera", camera, self.cameras), ("slot", k, self.slots_per_camera))
        for what, value, count in limits:
            if not 0 <= value < count:
                raise InputError.field("ring", what, value, f"0 … {count - 1}")
        return (bay * self.cameras + camera) * self.slots_per_camera + k

    def place(self, slot: int) -> tuple[int, int, int]:
        """Return (bay, camera, k) for the number of a slot. k counts the slots of this camera in this bay.

        This is the inverse of `slot`.
        """
        if not 0 <= slot < self.slots:
            raise InputError.field("ring", "slot", slot, f"0 … {self.slots - 1}")
        rest, k = divmod(slot, self.slots_per_camera)
        bay, camera = divmod(rest, self.cameras)
        return bay, camera, k

    def offset(self, slot: int) -> int:
        """Return the offset of a slot's first byte in the file."""
        return self.first_slot + slot * self.slot_bytes

    def header(self, pid: int, start_ticks: int) -> NDArray[Any]:
        """Return the header page as an array (1,), in the state BUILDING."""
        page = np.zeros(1, dtype=HEADER)
        page["magic"] = MAGIC
        for key, value in (
            ("layout_version", LAYOUT_VERSION), ("header_bytes", PAGE_BYTES), ("file_bytes", self.file_bytes),
            ("owner_pid", pid), ("owner_start_ticks", start_ticks), ("state", BUILDING), ("bays", self.bays),
            ("cameras", self.cameras), ("slots_per_camera", self.slots_per_camera), ("page_bytes", PAGE_BYTES),
            ("slot_bytes", self.slot_bytes), ("camera_table", self.camera_table), ("bay_table", self.bay_table),
            ("slot_table", self.slot_table), ("first_slot", self.first_slot),
        ):  # fmt: skip
            page[key] = value
        return page

    def camera_records(self) -> NDArray[Any]:
        """Return the camera table as an array (cameras,) of records."""
        rows = [(f.width, f.height, f.format.code, f.format.bytes_per_pixel) for f in self.frames]
        return np.array(rows, dtype=CAMERA_RECORD)

    @classmethod
    def read(cls, header: NDArray[Any], cameras: NDArray[Any]) -> RingLayout:
        """Read the layout of a file from its `header` (1,) HEADER and its camera table `cameras` (n,) CAMERA_RECORD."""
        # An unknown code is kept as hexadecimal text. FrameShape then refuses it with the list of known formats.
        names = {known.code: name for name, known in PIXEL_FORMATS.items()}
        frames = tuple(
            FrameShape(int(c["width"]), int(c["height"]), names.get(int(c["pixel_format"]), hex(c["pixel_format"])))
            for c in cameras
        )
        plain = cls(int(header["bays"][0]), int(header["slots_per_camera"][0]), frames)
        return replace(plain, room_bytes=max(int(header["slot_bytes"][0]) - plain.slot_bytes, 0))


def _pages(nbytes: int) -> int:
    return -(-nbytes // PAGE_BYTES) * PAGE_BYTES

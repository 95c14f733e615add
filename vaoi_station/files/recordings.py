"""Read and write recordings: directories with `recording.json` and frames, optionally calibration and board type."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.files.images import SUFFIXES, Image, read_image, write_image
from vaoi_station.model import RecordingHead
from vaoi_station.pixel_formats import to_full_scale

_ROTATIONS = (0, 90, 180, 270)
_DEPTHS = (8, 10, 12, 14, 16)
_MOST_SAMPLED = 32
"""Number of frames from which the depth of a recording is estimated if its head does not state it."""


@dataclass(frozen=True)
class Recording:
    """An opened recording: its head is in memory, its frames are read on demand."""

    directory: Path
    head: RecordingHead

    def frame_path(self, camera: int, row: int) -> Path | None:
        """Return the file of one frame; None if the frame is missing."""
        if (camera, row) in self.head.missing:
            return None
        if (path := frame_file(self.directory, camera, row)) is not None:
            return path
        stem = self.directory / "frames" / _name(camera, row)
        raise InputError(
            f"{stem}.png: the frame is absent and not listed under 'missing' in recording.json.",
            action=f"Restore the file, or add [{camera}, {row}] to 'missing'.",
        )

    def frame(self, camera: int, row: int) -> Image | None:
        """Read a frame and check it against the head; None if it is missing. 16-bit pixels are scaled to 0 … 65535."""
        image = self._read(camera, row)
        return image if image is None or image.dtype == np.uint8 else self._at_full_scale(image, camera, row)

    @property
    def estimated_bits(self) -> int | None:
        """Used bits of 16-bit pixels, by an estimate; None if `recording.json` states them, or for frames of 8 bits."""
        unstated = [i for i, camera in enumerate(self.head.cameras) if camera.bits is None]
        first = (next((j for j in range(self.head.rows) if (i, j) not in self.head.missing), None) for i in unstated)
        frames = (self._read(i, j) for i, j in zip(unstated, first, strict=True) if j is not None)
        return self._estimated_bits if any(f is not None and f.dtype == np.uint16 for f in frames) else None

    @cached_property
    def _estimated_bits(self) -> int:
        """The number of used bits of 16-bit pixels, by the brightest pixel of frames from all parts of the recording.

        All cameras have the same value, because a dark camera or a dark row must not be brightened more than the
        others.
        """
        lost = set(self.head.missing)
        keys = [(i, j) for i in range(len(self.head.cameras)) for j in range(self.head.rows) if (i, j) not in lost]
        chosen = np.unique(np.linspace(0, len(keys) - 1, min(len(keys), _MOST_SAMPLED)).round().astype(int))
        pictures = (self._read(*keys[k]) for k in chosen)
        used = max((int(p.max()).bit_length() for p in pictures if p is not None and p.dtype == np.uint16), default=16)
        return next(depth for depth in _DEPTHS if depth >= used)

    def _at_full_scale(self, image: Image, camera: int, row: int) -> Image:
        stated = self.head.cameras[camera].bits
        bits = stated or self._estimated_bits
        if bits < 16 and int(image.max()) >> bits:
            source = "recording.json says" if stated else "other frames of the recording use"
            raise InputError(
                f"{self.frame_path(camera, row)}: has the pixel value {int(image.max())}, but {source} {bits} bits "
                f"(limit {(1 << bits) - 1}).",
                action=f"Set cameras[{camera}].bits in recording.json to the bits that the camera uses.",
            )
        return to_full_scale(image, bits)

    def _read(self, camera: int, row: int) -> Image | None:
        """Read one frame as its file contains it, and check its size against the head; None if the frame is missing."""
        path = self.frame_path(camera, row)
        if path is None:
            return None
        image, head = read_image(path), self.head.cameras[camera]
        if image.shape[:2] != (head.height, head.width):
            raise InputError(
                f"{path}: is {image.shape[1]}×{image.shape[0]} px, "
                f"but recording.json says {head.width}×{head.height} px for camera {camera}."
            )
        return image

    def with_rotation(self, rotation_deg: int | None) -> Recording:
        """Return the recording with another expected rotation of the board; unchanged if none (None) is given."""
        if rotation_deg is None:
            return self
        if rotation_deg not in _ROTATIONS:
            raise InputError(
                f"the rotation is {rotation_deg!r}, but must be 0, 90, 180 or 270 degrees.",
                action="Give the turn of the board on the belt, counter-clockwise from CAD-upright as most cameras see "
                "it.",
            )
        return Recording(self.directory, self.head.model_copy(update={"rotation_deg": rotation_deg}))

    def copy_head(self, directory: Path) -> None:
        """Write the head to another directory: a copy of the file, but with the rotation of this recording."""
        data = read_json(self.directory / "recording.json")
        if data.get("rotation_deg") == self.head.rotation_deg:
            shutil.copyfile(self.directory / "recording.json", directory / "recording.json")
        else:
            write_json(directory / "recording.json", data | {"rotation_deg": self.head.rotation_deg})


def frame_file(directory: Path, camera: int, row: int) -> Path | None:
    """Return the file of one frame in the directory of a recording; None if there is no such file."""
    paths = (directory / "frames" / f"{_name(camera, row)}{suffix}" for suffix in SUFFIXES)
    return next((path for path in paths if path.is_file()), None)


def open_recording(directory: Path) -> Recording:
    """Open a recording, and check that all its frame files exist."""
    path = directory / "recording.json"
    data = read_json(path)
    check_format(data, path, "vaoi-recording", 1)
    recording = Recording(directory, parse(RecordingHead, data, path))
    for camera in range(len(recording.head.cameras)):
        for row in range(recording.head.rows):
            recording.frame_path(camera, row)  # refuses a frame that is absent but not listed as missing
    return recording


def write_recording(
    directory: Path, head: RecordingHead, frames: Iterable[tuple[int, int, Image]], suffix: str = ".png"
) -> Recording:
    """Write frames (camera, row, pixels) first and the head last: a directory with a head is complete.

    Frames are PNG, or uncompressed ".tiff" for recordings that are read often.
    """
    # The head of an older recording is removed first: new frames under an old head would count as complete.
    (directory / "recording.json").unlink(missing_ok=True)
    for camera, row, image in frames:
        write_image(directory / "frames" / f"{_name(camera, row)}{suffix}", image)
    write_json(directory / "recording.json", head.model_dump(mode="json", exclude_none=True))
    return open_recording(directory)


def _name(camera: int, row: int) -> str:
    return f"c{camera:02d}_r{row:03d}"

"""Read and write recordings: directories with `recording.json` and frames, optionally calibration and board type."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.files.images import SUFFIXES, Image, read_image, write_image
from vaoi_station.model import RecordingHead


@dataclass(frozen=True)
class Recording:
    """An opened recording: its head is in memory, its frames are read on demand."""

    directory: Path
    head: RecordingHead

    def frame_path(self, camera: int, row: int) -> Path | None:
        """Return the file of one frame; None if the frame is missing."""
        if (camera, row) in self.head.missing:
            return None
        stem = self.directory / "frames" / f"c{camera:02d}_r{row:03d}"
        for suffix in SUFFIXES:
            path = stem.with_suffix(suffix)
            if path.is_file():
                return path
        raise InputError(
            f"{stem}.png: the frame is absent and not listed under 'missing' in recording.json.",
            action=f"Restore the file, or add [{camera}, {row}] to 'missing'.",
        )

    def frame(self, camera: int, row: int) -> Image | None:
        """Read one frame and check its size against the head; None if the frame is missing."""
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

    def check_files(self) -> None:
        """Raise InputError if a frame's file is absent although the head does not list the frame as missing."""
        for camera in range(len(self.head.cameras)):
            for row in range(self.head.rows):
                self.frame_path(camera, row)


def open_recording(directory: Path) -> Recording:
    """Open a recording, and check that all its frame files exist."""
    path = directory / "recording.json"
    data = read_json(path)
    check_format(data, path, "vaoi-recording", 1)
    recording = Recording(directory, parse(RecordingHead, data, path))
    recording.check_files()
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
        write_image(directory / "frames" / f"c{camera:02d}_r{row:03d}{suffix}", image)
    write_json(directory / "recording.json", head.model_dump(mode="json", exclude_none=True))
    return open_recording(directory)

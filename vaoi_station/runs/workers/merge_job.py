"""The jobs of merging frames of several exposures, and of estimating how bright the rows of a run are, in a worker."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from vaoi_station.files.images import read_kept_image
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.hdr import Exposed
from vaoi_station.hdr.bodies import Body, merge_region
from vaoi_station.hdr.encoding import encode_merged
from vaoi_station.hdr.row_levels import row_levels
from vaoi_station.model import BoardType, Stitch
from vaoi_station.photometry import FlatFields, Taken
from vaoi_station.photometry.flat_fields import changed_ns
from vaoi_station.rendering import View
from vaoi_station.runs.workers.jobs import FramesJob, RenderJob

MOST_DECODED = 500_000_000
"""Largest number of pixels that a comparison of rows decodes from files: more would take a worker longer than it may.
Frames in memory are not decoded, and only the windows that are compared are read."""


class MergedFrame(NamedTuple):
    """One frame of a merge: its view, how it was taken, its size in px, and its slot in the ring or its file."""

    view: View
    taken: Taken
    size: tuple[int, int]
    slot: int
    file: Path | None = None


class MergedBody(NamedTuple):
    """A body in the picture of a region, with its frames in the plane of its top."""

    body: Body
    frames: tuple[MergedFrame, ...]


@dataclass(frozen=True)
class MergeJob(RenderJob):
    """Merge frames to linear radiance; the reply's value is the encoded picture.

    `slot` and `view` are those of the best frame.
    """

    frames: tuple[MergedFrame, ...] = ()
    bodies: tuple[MergedBody, ...] = ()
    """Bodies in the picture of a region."""
    flat_fields: Path | None = None
    """Directory of the flat fields; None: the flat is 1 and the dark level 0."""
    sigma: bool = False
    """Whether the standard deviation is returned in place of the radiance."""

    def __str__(self) -> str:
        return f"a picture merged of {len(self.frames)} frames of run {self.run}"


def merge(job: MergeJob, frame: Callable[[int], NDArray[Any]]) -> bytes:
    """Perform a job. `frame` returns the frame in a slot of the ring, which is not copied."""
    fields = opened_fields(job.flat_fields)

    def exposed(frames: Iterable[MergedFrame]) -> list[Exposed]:
        return [
            Exposed(f.view, f.taken, fields.maps(f.view.camera, f.taken.light), f.size, partial(_pixels, f, frame))
            for f in frames
        ]

    bodies = [(of.body, exposed(of.frames)) for of in job.bodies]
    picture = merge_region(exposed(job.frames), bodies, groups=False, sigma=job.sigma)[-1]
    return encode_merged(picture.sigma if job.sigma else picture.value, job.format)


def _pixels(wanted: MergedFrame, frame: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
    return frame(wanted.slot) if wanted.file is None else read_kept_image(wanted.file)


def opened_fields(directory: Path | None) -> FlatFields:
    """Return flat fields, which are read again when their document changes."""
    if directory is None:
        return FlatFields.none()
    return _opened(directory, changed_ns(directory))


@lru_cache(maxsize=1)
def _opened(directory: Path, _changed_ns: int) -> FlatFields:
    return FlatFields.open(directory)


class LevelFrame(NamedTuple):
    """A frame of a run: how it was taken, its slot in the ring, or its file."""

    camera: int
    row: int
    taken: Taken
    slot: int
    file: Path | None = None


@dataclass(frozen=True)
class RowLevelsJob(FramesJob):
    """Estimate the brightness of the rows of a run; the reply's value is (m,) factors."""

    run: str
    bay: int
    generation: int
    frames: tuple[LevelFrame, ...]
    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    """The cameras with which the run was stitched."""
    flat_fields: Path
    recorded: bool = False
    """Whether the frames are read from files, so that no bay is needed."""
    request: int = 0

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> Floats:
        """Compare the rows; `frame` returns the pixels of a slot."""
        frames = {(f.camera, f.row): f for f in self.frames}

        def pixels(camera: int, row: int) -> NDArray[Any]:
            wanted = frames[camera, row]
            return frame(wanted.slot) if wanted.file is None else read_kept_image(wanted.file)

        taken = {key: f.taken for key, f in frames.items()}
        fields = opened_fields(self.flat_fields)
        most = MOST_DECODED if self.recorded else math.inf
        return row_levels(taken, self.board_type, self.stitch, self.cameras, fields, pixels, most)

    def __str__(self) -> str:
        return f"the brightness of the rows of run {self.run}"

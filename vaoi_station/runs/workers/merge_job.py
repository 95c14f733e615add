"""The job of merging frames of several exposures of one component or region, and its execution in a worker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from vaoi_station.files.images import read_kept_image
from vaoi_station.hdr import Exposed, merge_views
from vaoi_station.hdr.encoding import encode_merged
from vaoi_station.photometry import FlatFields, Taken
from vaoi_station.rendering import View
from vaoi_station.runs.workers.jobs import RenderJob


class MergedFrame(NamedTuple):
    """One frame of a merge: its view, how it was taken, its size in px, and its slot in the ring or its file."""

    view: View
    taken: Taken
    size: tuple[int, int]
    slot: int
    file: Path | None = None


@dataclass(frozen=True)
class MergeJob(RenderJob):
    """Merge frames to linear radiance; the reply's value is the encoded picture.

    `slot` and `view` are those of the best frame.
    """

    frames: tuple[MergedFrame, ...] = ()
    flat_fields: Path | None = None
    """Directory of the flat fields; None: the flat is 1 and the dark level 0."""
    sigma: bool = False
    """Whether the standard deviation is returned in place of the radiance."""

    def __str__(self) -> str:
        return f"a picture merged of {len(self.frames)} frames of run {self.run}"


def merge(job: MergeJob, frame: Callable[[int], NDArray[Any]]) -> bytes:
    """Perform a job. `frame` returns the frame in a slot of the ring, which is not copied."""
    fields = opened_fields(job.flat_fields)
    exposed = [
        Exposed(f.view, f.taken, fields.maps(f.view.camera, f.taken.light), f.size, partial(_pixels, f, frame))
        for f in job.frames
    ]
    picture = merge_views(exposed, groups=False)[-1]
    return encode_merged(picture.sigma if job.sigma else picture.value, job.format)


def _pixels(wanted: MergedFrame, frame: Callable[[int], NDArray[Any]]) -> NDArray[Any]:
    return frame(wanted.slot) if wanted.file is None else read_kept_image(wanted.file)


def opened_fields(directory: Path | None) -> FlatFields:
    """Return flat fields, which are read again when their document changes."""
    if directory is None:
        return FlatFields.none()
    return _opened(directory, (directory / "flatfield.json").stat().st_mtime_ns if directory.is_dir() else 0)


@lru_cache(maxsize=1)
def _opened(directory: Path, _changed_ns: int) -> FlatFields:
    return FlatFields.open(directory)

"""Overviews of runs in spare time, and small pictures of whole boards that are kept when the frames are gone.

Some time after a run, a worker plans its mosaic and makes the overview, in a job of spare time that is sent
only while no board is filmed or stitched. A level of it of at most two megapixels is kept as a file. No lease is taken:
if the frames are needed for the next board first, the run gets neither.
"""

from __future__ import annotations

import logging
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic
from typing import NamedTuple

from vaoi_station.config import KeepConfig
from vaoi_station.errors import NotFoundError, StateError, VaoiError
from vaoi_station.files.documents import write_bytes
from vaoi_station.files.images import encode_jpeg
from vaoi_station.mosaic import MosaicGrid
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.archive.recordings import DISK_RESERVE
from vaoi_station.runs.mosaics.mosaics import Mosaics
from vaoi_station.runs.mosaics.opened_mosaics import PictureName
from vaoi_station.runs.run.memory import Bay, FrameSource
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.supervised_queue import SupervisedQueue

_log = logging.getLogger(__name__)

DIRECTORY = "mosaics"
MOST_PX = 2_000_000
"""Largest number of pixels of a kept picture; it takes some 0.3 MB."""
_QUALITY = 85
_MOST_WAITING = 8
"""Largest number of runs that wait for overview and picture; the oldest ones then get none."""
DELAY_S = 1.0
"""Time from the end of a run during which its frames are left to the tester's own requests."""
_LOOK_S = 0.25
"""Time between two checks whether the line is idle."""
_MOST_SWEPT = 20
"""Largest number of pictures of forgotten runs that are deleted in one call."""
_NAME = re.compile(r"(?P<run>[0-9a-z-]+)_(?P<reduction>[0-9]+)\.jpg")


class _File(NamedTuple):
    """A kept picture: by how much it is reduced, and its size in bytes."""

    reduction: int
    size_bytes: int


class KeptMosaics:
    """The kept pictures below one directory, and the thread that makes them. Methods may be called from any thread."""

    def __init__(
        self,
        directory: Path,
        keep: KeepConfig,
        archive: Archive,
        mosaics: Mosaics,
        frames: FrameSource,
        events: EventLog,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._directory, self._quota = directory, int(keep.mosaics_gb * 1e9)
        self._archive, self._mosaics, self._frames, self._events = archive, mosaics, frames, events
        self._clock = clock
        self._lock = threading.Lock()
        self._files: dict[str, _File] = {}
        """The kept pictures by run id. Ids sort by time."""
        for path in directory.glob("*.jpg"):
            if match := _NAME.fullmatch(path.name):
                with suppress(FileNotFoundError):
                    self._files[match["run"]] = _File(int(match["reduction"]), path.stat().st_size)
        self.queue: SupervisedQueue[tuple[str, float]] = SupervisedQueue(self._make, "mosaics", _MOST_WAITING)
        """The runs that wait for overview and picture, with the time from which on these may be made."""

    @property
    def runs(self) -> int:
        """Number of kept pictures."""
        return len(self._files)

    @property
    def size_bytes(self) -> int:
        """Size of all kept pictures."""
        return sum(file.size_bytes for file in list(self._files.values()))

    def finished(self, detail: RunDetail) -> None:
        """Have overview and picture of a run made that has just ended; it returns at once."""
        if detail.frames_available:
            self.queue.put((detail.id, self._clock() + DELAY_S))

    def grid(self, run: str) -> MosaicGrid | None:
        """Return the pixel grid of the kept picture of a run; None if none is kept."""
        file = self._files.get(run)
        return None if file is None else self._mosaics.grid(run, PictureName()).reduced(file.reduction)

    def content(self, run: str) -> bytes:
        """Return the kept picture of a run as JPEG. NotFoundError: there is none. GoneError: the run was forgotten."""
        self._archive.get(run)
        file = self._files.get(run)
        with suppress(FileNotFoundError):
            if file is not None:
                return self._path(run, file.reduction).read_bytes()
        raise NotFoundError(
            f"No picture of the whole board of run {run} is kept.",
            action="It is made in spare time after a run, within [keep] mosaics_gb. Pin runs whose frames are needed.",
            code="no-kept-mosaic",
        )

    def tend(self) -> None:
        """Delete pictures of forgotten runs, and the oldest ones beyond the quota and while space is short."""
        with self._lock:
            oldest = sorted(self._files)[:_MOST_SWEPT]
            known = self._archive.summaries(oldest) if oldest else {}
            for run in oldest:
                if run not in known or known[run].forgotten:
                    self._delete(run)
            while self._files and (
                self.size_bytes > self._quota or shutil.disk_usage(self._directory).free < DISK_RESERVE // 2
            ):
                if not self._drop_oldest():
                    return

    def _path(self, run: str, reduction: int) -> Path:
        return self._directory / f"{run}_{reduction}.jpg"

    def _make(self, wanted: tuple[str, float]) -> None:
        """Make the overview of a run, and keep a picture of it, if its frames stay for long enough."""
        run, from_s = wanted
        try:
            while (left_s := from_s - self._clock()) > 0 and not self.queue.pause(min(left_s, _LOOK_S)):
                pass
            picture, reduction = self._mosaics.small(run, MOST_PX, self._spare)
            if self._quota and run not in self._files:
                self._keep(run, reduction, encode_jpeg(picture, _QUALITY))
        except VaoiError as reason:
            _log.info("no picture of run %s is kept: %s", run, reason.message)
        except OSError as fault:
            self._report(run, f"{self._directory}: cannot be written ({fault.strerror}).")
        except Exception as fault:  # noqa: BLE001  the thread must go on: later runs need it
            _log.warning("picture of run %s failed", run, exc_info=True)
            self._report(run, f"{type(fault).__name__}: {fault}.")

    def _report(self, run: str, why: str) -> None:
        self._events.add(
            "trouble",
            f"The picture of the whole board was not kept: {why}",
            run=run, code="mosaic-not-kept", action="Free disk space; else report it to the maintainer.",
        )  # fmt: skip

    @contextmanager
    def _spare(self, run: str, purpose: str) -> Iterator[Bay]:
        """Wait until no board is under way, and yield the bay of a run without a lease."""
        while self._frames.busy() and not self.queue.pause(_LOOK_S):
            pass
        if self.queue.stopping:
            raise StateError(f"The station is stopping; there is no {purpose}.")
        yield self._frames.bay_of(run)

    def _keep(self, run: str, reduction: int, content: bytes) -> None:
        """Write a picture, in place of the oldest ones that are not pinned."""
        self._directory.mkdir(parents=True, exist_ok=True)
        with self._lock:
            while self.size_bytes + len(content) > self._quota:
                if not self._drop_oldest():
                    return
            if shutil.disk_usage(self._directory).free < DISK_RESERVE:
                return
            write_bytes(self._path(run, reduction), content)
            self._files[run] = _File(reduction, len(content))

    def _drop_oldest(self) -> bool:
        """Delete the oldest picture whose run is not pinned; return whether there was one."""
        oldest = min(self._files.keys() - self._archive.retention.pins(), default=None)
        if oldest is not None:
            self._delete(oldest)
        return oldest is not None

    def _delete(self, run: str) -> None:
        file = self._files.pop(run)
        self._path(run, file.reduction).unlink(missing_ok=True)

"""Recordings of runs whose frames are worth keeping (failed, degraded or pinned), within a quota of disk space.

One thread of the lowest priority copies frames out of the ring. It never delays the line: it holds no lease while it
writes. If a run's memory is given to a later board meanwhile, the run is not kept, and this is counted.
"""

from __future__ import annotations

import logging
import shutil
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.config import KeepConfig
from vaoi_station.errors import DeviceError, GoneError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.files import read_board_type, write_board_type, write_calibration, write_recording
from vaoi_station.files.directories import new_directory, readable_size_below, remove_directory, size_below
from vaoi_station.files.documents import parse, read_json, write_bytes, write_json
from vaoi_station.files.images import Image
from vaoi_station.files.recordings import frame_file
from vaoi_station.identity.comparison import compare
from vaoi_station.model import Program, RecordingHead, Status
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.archive.housekeeping import TASK_LIMIT_S
from vaoi_station.runs.run.memory import FrameSource
from vaoi_station.runs.run.verdict import RunVerdict, identified
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

DIRECTORY = "recordings"
MOST_WAITING = 16
"""Largest number of runs that wait to be written; the ring holds fewer in most stations."""
DISK_RESERVE = 2_000_000_000
"""Free space in bytes that recordings leave on the disk for the database."""
RUN_FILE, RESULT_FILE, HEAD_FILE = "run.json", "result.json", "recording.json"
LIGHT_PROGRAM_FILE = "light_program.json"
FOR_ARCHIVE_FILE = "for_archive"
"""Empty file in a recording that is deleted as soon as an archive has it; it holds beyond a restart of the station."""


@dataclass
class Counts:
    """Numbers of the runs whose frames were to be kept since the start, by outcome."""

    kept: int = 0
    late: int = 0
    """Number of runs whose memory was needed for a later board before their frames were written."""
    refused: int = 0
    """Number of runs that were not kept because of the quota, the disk or a fault."""


class Recordings:
    """The kept recordings below one directory, and the thread that writes them."""

    def __init__(
        self, directory: Path, keep: KeepConfig, archive: Archive, events: EventLog, frames: FrameSource
    ) -> None:
        self.directory, self._keep, self._quota = directory, keep, int(keep.recordings_gb * 1e9)
        self._archive, self._events, self._frames = archive, events, frames
        self.counts = Counts()
        self.program: Program = ()
        """Light program of station.toml, for board types without one."""
        self.wanted_for_archive: Callable[[RunDetail], bool] = lambda _detail: False
        """Function that returns whether a run that is not kept otherwise is kept until an archive has it."""
        self.awaited: Callable[[], Iterable[str]] = tuple
        """Function that returns the runs that the archive is to take, also of those that are kept otherwise."""
        self.on_kept: Callable[[str], None] = lambda _run: None
        """Function that is called with a run whose recording is complete: its frames are kept and the identity of its
        board is decided. It is called again if its record changes. It must return at once."""
        self._wake = threading.Condition()
        """Guards the tasks of the thread; never held while the disk is awaited."""
        self._waiting: deque[tuple[str, bool]] = deque()
        """Runs to be written, and whether for an archive only. They come first: their memory is needed soon."""
        self._updates: dict[str, bool] = {}
        """Recordings whose records are to be brought up to date, and whether they are offered unchanged as well."""
        self._outdated: set[str] = set()
        """Runs whose records could not be brought up to date; they are tried again."""
        self._unexplained: set[str] = set()
        """Runs whose recording may have a result that is not complete yet."""
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self.thread = SupervisedThread(self._run, "recordings", TASK_LIMIT_S)
        # Drafts that a killed station left. Their names begin with a dot, those of recordings do not.
        for draft in directory.glob(".*"):
            shutil.rmtree(draft, ignore_errors=True)
        archive.retention.pins()  # This is read now because `finished` must not wait for the disk.
        self._sizes, self._for_archive = dict[str, int](), set[str]()
        self._take_in()

    def start(self) -> None:
        """Start the thread that writes recordings; first it brings the records of those of earlier runs up to date."""
        # The station may have ended after the identity of a run was decided, and before its recording had it.
        self._update_later(*self.all(), offer=False)
        self.thread.start()

    def stop(self) -> None:
        """End the thread. A recording that is being written is given up, and its files are removed."""
        self.thread.expect_end()
        with self._wake:
            self._stopping.set()
            self._wake.notify_all()
        if self.thread.is_alive():
            self.thread.join()

    def finished(self, detail: RunDetail) -> None:
        """Keep the frames of a run if the configuration keeps runs with its verdict. Returns at once.

        It is called when the run has ended, and again if it is degraded afterwards.
        """
        wanted = detail.verdict is not Status.OK and self._keep.recordings_of_failed
        if wanted or self._archive.retention.pinned(detail.id):
            self.request(detail.id)
        elif self.wanted_for_archive(detail):
            self.request(detail.id, for_archive=True)

    def request(self, run: str, *, for_archive: bool = False) -> None:
        """Keep the frames of a finished run, for good or until an archive has them. Returns at once."""
        known = run in self._sizes and (for_archive or run not in self._for_archive)
        if not self._quota or known or self._stopping.is_set():
            return
        with self._wake:
            if has_room := len(self._waiting) < MOST_WAITING:
                self._waiting.append((run, for_archive))
                self._wake.notify_all()
        if not has_room:
            self._late(run)

    def update(self, run: str) -> None:
        """Bring the record in the recording of a run up to date, if one is kept. Returns at once."""
        # A run that is just being written is brought up to date in the end: it is in `_sizes` before that.
        if run in self._sizes:
            self._update_later(run, offer=False)

    def offer_all(self) -> None:
        """Bring the records of all recordings up to date, and offer these to `on_kept`. Returns at once."""
        self._update_later(*self.all(), offer=True)

    def _update_later(self, *runs: str, offer: bool) -> None:
        with self._wake:
            for run in runs:
                self._updates[run] = offer or self._updates.get(run, False)
            self._wake.notify_all()

    def path_of(self, run: str) -> Path | None:
        """Return the recording of a run; None if none is kept."""
        return self.directory / run if run in self._sizes else None

    def frame_file(self, run: str, camera: int, row: int) -> Path | None:
        """Return the file of a frame in the recording of a run; None if no recording of the run is kept.

        Raises GoneError if the recording does not have this frame.
        """
        if (directory := self.path_of(run)) is None:
            return None
        if (path := frame_file(directory, camera, row)) is None:
            raise GoneError(
                f"Camera {camera}, row {row} of run {run} is no longer in memory, and its recording {directory} does "
                "not have it: only frames that are complete and proven were kept.",
                action=f"Use the other frames of the run, here or by vaoi cut {directory}.",
                code="frames-gone",
            )
        return path

    def all(self) -> tuple[str, ...]:
        """Return the ids of the runs of which a recording is kept, oldest first."""
        return tuple(sorted(self._sizes.copy()))

    def release(self, run: str) -> None:
        """Delete the recording of a run that an archive has now, if it was kept for this only."""
        with self._lock:
            if run in self._for_archive:
                if self._archive.retention.pinned(run):
                    self._keep_beyond_archive(run)
                else:
                    self._delete(run)

    @property
    def runs(self) -> int:
        """Number of kept recordings."""
        return len(self._sizes)

    @property
    def size_bytes(self) -> int:
        """Size of all kept recordings."""
        return sum(self._sizes.copy().values())

    def tend(self) -> None:
        """Take in what `vaoi import` has added, and delete recordings while the disk is short of space."""
        self._archive.retention.refresh_pins()
        with self._lock:
            self._take_in()
        self._update_later(*self._outdated.copy(), offer=True)
        # The quota may be lower now.
        while self._sizes and (self.size_bytes > self._quota or self._free() < DISK_RESERVE // 2):
            if not self._drop_oldest():
                return

    def _take_in(self) -> None:
        """Enter the recordings on the disk that are not known yet, without those that cannot be read."""
        for path in self.directory.glob("[!.]*"):
            size = None if path.name in self._sizes else readable_size_below(path)
            # Asked afterwards: an import that failed meanwhile has removed its recording.
            if size is not None and (path / HEAD_FILE).is_file():
                self._sizes[path.name] = size
                if (path / FOR_ARCHIVE_FILE).exists():
                    self._for_archive.add(path.name)

    def _run(self) -> None:
        """Write runs and bring records up to date, until the thread is to end."""
        while True:
            with self.thread.waiting(), self._wake:
                while not (self._stopping.is_set() or self._waiting or self._updates):
                    self._wake.wait()
                if self._stopping.is_set():
                    return
                wanted = self._waiting.popleft() if self._waiting else None
                run = next(iter(self._updates)) if wanted is None else wanted[0]
                offer = wanted is None and self._updates.pop(run)
            if wanted is None:
                self._update(run, offer=offer)
            else:
                self._keep_run(run, for_archive=wanted[1])

    def _keep_run(self, run: str, *, for_archive: bool) -> None:
        try:
            self._write(run, for_archive=for_archive)
        except GoneError:
            self._late(run)
        except StateError:
            return  # The station is stopping.
        except Exception as error:  # noqa: BLE001  the thread must go on: it keeps the frames of later runs
            if isinstance(error, VaoiError):
                why: str = error.message
            elif isinstance(error, OSError):
                why = f"{self.directory}: cannot be written ({error.strerror})."
            else:
                _log.warning("recording of run %s failed", run, exc_info=True)
                why = f"{type(error).__name__}: {error}."
            self.counts.refused += 1
            action = "Unpin runs, raise [keep] recordings_gb, or free disk space."
            message = f"The frames were not kept: {why}"
            self._events.add("trouble", message, run=run, code="recording-refused", action=action)

    def _late(self, run: str) -> None:
        with self._lock:
            self.counts.late += 1
        message = "The frames were not kept: their memory was needed for a later board before they were on disk."
        action = "Increase [ring] runs, or use a faster disk."
        self._events.add("trouble", message, run=run, code="recording-late", action=action)

    def _write(self, run: str, *, for_archive: bool) -> None:
        if run in self._sizes:
            with self._lock:
                if run in self._for_archive and not for_archive:
                    self._keep_beyond_archive(run)
            return
        finished = self._archive.get(run)
        if finished.head is None:
            return
        head = head_of(finished.detail, finished.head)
        absent = set(head.missing)
        slots = {key: slot for key, slot in finished.slots.items() if key not in absent}
        copy = self._frames.copier(self._frames.bay_of(run))
        # One frame of every camera states its size on disk: its pixel format is nowhere else.
        of_cameras = {camera: slot for (camera, _), slot in slots.items()}
        self._make_room(sum(copy(slot).nbytes for slot in of_cameras.values()) * head.rows)

        def copies() -> Iterator[tuple[int, int, Image]]:
            for (camera, row), slot in slots.items():
                if self._stopping.is_set():
                    raise StateError("The station is stopping.")
                self.thread.beat()
                yield camera, row, copy(slot)

        target = self.directory / run
        with new_directory(target) as draft:
            # Uncompressed, because the frames must be out of the ring before their memory is needed.
            write_recording(draft, head, copies(), suffix=".tiff")
            write_calibration(draft / "calibration.json", self._archive.calibration_of(finished))
            write_board_type(draft / "board.json", finished.board_type)
            write_bytes(draft / RUN_FILE, finished.detail.model_dump_json().encode())
            if finished.document is not None:
                write_bytes(draft / RESULT_FILE, finished.text.encode())
                if not finished.complete:
                    self._unexplained.add(run)  # `_renewed` replaces it
            if program := finished.board_type.program or self.program:
                steps = [step.model_dump(mode="json", exclude_none=True) for step in program]
                write_json(draft / LIGHT_PROGRAM_FILE, steps)
            if for_archive:
                write_bytes(draft / FOR_ARCHIVE_FILE, b"")
        with self._lock:
            self._sizes[run] = size_below(target)
            if for_archive:
                self._for_archive.add(run)
        self.counts.kept += 1
        self._events.add("recording", "The frames are kept as a recording.", run=run)
        # The identity may have been decided before `update` knew of the recording.
        self._update(run, offer=True)

    def _update(self, run: str, *, offer: bool) -> None:
        """Bring the record of a recording up to date, and offer the recording if it is complete and has changed."""
        self._outdated.discard(run)
        try:
            record, changed = self._renewed(run)
        except Exception as error:  # noqa: BLE001  the thread must go on: it keeps the frames of later runs
            # Without its record the recording is offered to no archive.
            _log.warning("record of the recording of run %s: %s; it is tried again", run, error)
            self._outdated.add(run)
            return
        # An imported run is for its own station to hand over.
        final = record is not None and record.identity_decided and run not in self._unexplained
        if final and record is not None and record.origin is None and (changed or offer):
            self.on_kept(run)

    def _renewed(self, run: str) -> tuple[RunDetail | None, bool]:
        """Return the record in a recording, and whether it has changed; None if the recording was deleted.

        The record changes after the end of the run with the identity of its board, which may lower the verdict, and
        the result is completed.
        """
        path = self.directory / run / RUN_FILE
        known: RunDetail | None = None
        with suppress(NotFoundError, InputError):
            known = parse(RunDetail, read_json(path), path)
        # Asked first: a result that is completed after this is followed by another call.
        settled, finished = not self._archive.awaits_explanation(run), None
        try:
            finished = self._archive.get(run)
            record: RunDetail | None = finished.detail
        except (GoneError, NotFoundError):
            record = known
            if known is not None and not known.identity_decided:
                # No code of its board can be read any more.
                board_type = read_board_type(path.parent / "board.json")
                not_read = compare(board_type.identity, None, known.board_id)
                record = identified(known, RunVerdict(known.verdict, known.reasons), not_read)
        with self._lock:
            if run not in self._sizes or record is None:
                return None, False
            # An archive needs to know these of a record; the rest says where the frames are, which changes.
            lasting = (record.verdict, record.reasons, record.identity)
            changed = known is None or lasting != (known.verdict, known.reasons, known.identity)
            if changed:
                write_bytes(path, record.model_dump_json().encode())
            if run in self._unexplained and settled:
                changed = True
                if finished is not None and finished.complete:
                    write_bytes(path.with_name(RESULT_FILE), finished.text.encode())
                self._unexplained.discard(run)
        return record, changed

    def _make_room(self, needed: int) -> None:
        """Delete the oldest unpinned recordings until `needed` bytes fit; DeviceError if that is not possible."""
        self.directory.mkdir(parents=True, exist_ok=True)
        while self.size_bytes + needed > self._quota or needed > self._free() - DISK_RESERVE:
            if not self._drop_oldest():
                raise DeviceError(
                    f"{self.directory}: a recording of {needed / 1e6:.0f} MB exceeds [keep] recordings_gb "
                    f"({self._quota / 1e9:g}), or the free space of the disk.",
                )

    def _free(self) -> int:
        return shutil.disk_usage(self.directory).free

    def _drop_oldest(self) -> bool:
        """Delete the oldest recording that is not pinned, and return whether there was one.

        Those that no archive has yet go last. The archive's thread reports those that it awaits, this one the others.
        """
        with self._lock:
            awaited = set(self.awaited())
            no_copy = awaited | self._for_archive
            unpinned = self._sizes.keys() - self._archive.retention.pins()
            oldest = min(unpinned, key=lambda run: (run in no_copy, run), default=None)
            if oldest is not None:
                self._delete(oldest)
        if oldest in no_copy - awaited:
            message = "The run was not archived: its recording was deleted for lack of space."
            action = "Set up [archive], or raise [keep] recordings_gb."
            self._events.add("trouble", message, run=oldest, code="archive-dropped", action=action)
        return oldest is not None

    def _delete(self, run: str) -> None:
        del self._sizes[run]
        self._for_archive.discard(run)
        self._unexplained.discard(run)
        remove_directory(self.directory / run)

    def _keep_beyond_archive(self, run: str) -> None:
        """Keep a recording as if no archive had wanted it."""
        (self.directory / run / FOR_ARCHIVE_FILE).unlink(missing_ok=True)
        self._for_archive.discard(run)


def recorded_files(
    recorded: Callable[[str, int, int], Path | None], run: str, frames: Iterable[tuple[int, int]]
) -> dict[tuple[int, int], Path]:
    """Return the files of those frames (camera, row) of a run that its recording has; `recorded` is `frame_file`."""
    found = {}
    for camera, row in frames:
        with suppress(GoneError):  # the recording has only complete, proven frames
            if (file := recorded(run, camera, row)) is not None:
                found[camera, row] = file
    return found


def head_of(run: RunDetail, head: RecordingHead) -> RecordingHead:
    """Return the head of the recording: frames that are not usable are missing, with causes under `x_verdicts`."""
    there = {(f.camera, f.row) for f in run.frames if f.usable and f.slot is not None}
    everything = {(i, j) for i in range(len(head.cameras)) for j in range(head.rows)}
    bad = [
        {"camera": f.camera, "row": f.row, "verdict": str(f.verdict), "cause": f.cause}
        for f in run.frames
        if not f.usable
    ]
    missing = tuple(sorted(everything - there | set(head.missing)))
    return head.model_copy(update={"missing": missing, "x_run": run.id, "x_verdicts": bad})

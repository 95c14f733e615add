"""Parts of finished runs: measured by workers after each run of a taught board type, or on request, and stored.

What good boards look like is kept in one file for each of them, in a directory for each board type: a board is removed
from the good ones, or taken over from another station, with its file.
"""

from __future__ import annotations

import logging
import re
import shutil
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic_core import from_json

from vaoi_station.errors import BusyError, GoneError, InputError, NotFoundError, StateError
from vaoi_station.model import BoardLimits, BoardType, PartLimits
from vaoi_station.model.board_type import STORED_NAME
from vaoi_station.model.part_limits import beyond
from vaoi_station.parts.learned import ENDING
from vaoi_station.runs.archive.component_views import component_of
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.archive.kept_documents import KeptDocuments
from vaoi_station.runs.archive.recordings import recorded_files
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.states.schemas import (
    Disagreement,
    GoodBoard,
    GoodBoards,
    LimitsReport,
    MarkedPart,
    RunDetail,
)
from vaoi_station.runs.workers.jobs import PictureJob, Priority
from vaoi_station.runs.workers.parts_jobs import (
    MOST_GOOD,
    GoodFiles,
    PartsJob,
    PartViews,
    PartViewsJob,
    Taught,
    TeachJob,
)
from vaoi_station.supervised_queue import SupervisedQueue

_log = logging.getLogger(__name__)

DIRECTORY = "good-boards"
T = TypeVar("T")
_KEPT_VIEWS = 64
"""Number of parts whose pictures are kept in memory: they are asked for one by one."""
_KEPT = 16
"""Number of runs whose document is kept in memory."""
_MOST_WAITING = 8
"""Largest number of runs that wait for their parts to be measured; the oldest ones are then not measured."""
_MOST_NAMED = 500
"""Largest number of parts that the report about limits names."""
_ABSENT = 0.5
"""Probability of presence below which a part counts as absent in messages."""


class _Place(NamedTuple):
    """Where the frames of a run are: a bay of the ring, or files."""

    bay: int
    generation: int
    files: dict[tuple[int, int], Path] | None = None


class MeasuredParts:
    """Has parts measured by workers, stores the documents, and keeps good boards. Usable from any thread."""

    def __init__(
        self,
        archive: Archive,
        lease: Callable[[str, str], AbstractContextManager[Bay]],
        render: Callable[[PictureJob, str], Any],
        bay_of: Callable[[str], Bay],
        events: EventLog,
        directory: Path,
    ) -> None:
        """Store the parts, as `MeasuredHeights` does. `directory` is that of the good boards."""
        self._archive, self._lease, self._render, self._bay_of = archive, lease, render, bay_of
        self._events, self._directory = events, directory
        self.recorded: Callable[[str, int, int], Path | None] = lambda _run, _camera, _row: None
        """Function that returns the file of a frame in the run's recording, as `Recordings.frame_file` does."""
        self._views = lru_cache(_KEPT_VIEWS)(self._made_views)
        self._documents = KeptDocuments(archive.store.parts, _KEPT)
        self._by_heights = KeptDocuments(lambda _run: None, _KEPT)
        """Measures without good boards, which cost seconds: they hold until the first board is taught."""
        self._lock = threading.Lock()
        """Held during a measurement for a caller, or a teaching."""
        self.queue = SupervisedQueue(self._measure_after, "parts", _MOST_WAITING)
        """The runs whose parts are to be measured after their end; started and stopped by the owner."""

    def finished(self, detail: RunDetail) -> None:
        """Have the parts of a run measured that has just ended, if its board type was taught; it returns at once."""
        if self._good_files(detail.board_type):
            self.queue.put(detail.id)

    def document(self, run: str) -> bytes:
        """Return the measures of a run's parts as JSON.

        Raises:
            NotFoundError: the run is unknown or has no result.
            StateError: the run has no CAD mapping.
            GoneError: the frames are neither in memory nor recorded, and the parts were not measured before.
        """
        if (found := self.known(run)) is not None:
            return found
        # Of a run without frames it is said at once.
        finished = _checked(self._archive.get(run))
        if not recorded_files(self.recorded, run, finished.slots):
            self._bay_of(run)
        with self._lock:
            if (found := self.known(run)) is not None:
                return found
            return self._with_frames(finished, lambda place: self._measured(finished, place, Priority.RENDER))

    def measure_of(self, run: str, address: str) -> dict[str, Any] | None:
        """Return the measure of a part; None if the parts of the run were not measured."""
        content = self.known(run)
        return None if content is None else from_json(content)["parts"].get(address)

    def limits_of(self, run: str, address: str) -> PartLimits:
        """Return the limits of a part of a run, by the version of the board type with which it was filmed."""
        board_type = self._archive.get(run).board_type
        part, limits = component_of(board_type, address), board_type.limits or BoardLimits()
        return PartLimits.model_validate(limits.by_part({address: part.package}).get(address, {}))

    def views(self, run: str, address: str) -> PartViews:
        """Return the pictures of a part beside those of a good board; none if the frames of the run are gone.

        Raises the errors of `document`, except GoneError; NotFoundError: there is no such part.
        """
        return self._views(run, address, self._good_files(self._archive.get(run).board_type.name))

    def _made_views(self, run: str, address: str, good: GoodFiles) -> PartViews:
        finished = _checked(self._archive.get(run))
        part = component_of(finished.board_type, address)

        def perform(place: _Place) -> PartViews:
            job = PartViewsJob(**_of(finished, place), good=good, part=part)
            views: PartViews = self._render(job, f"of {address}")
            return views

        try:
            return self._with_frames(finished, perform)
        except GoneError:
            is_good = any(path.name == f"{run}{ENDING}" for path, _ in good)
            return perform(_Place(0, 0, {})) if is_good else PartViews()

    def teach(self, run: str) -> GoodBoards:
        """Keep a run as that of a good board of its type, and return the good boards.

        Its frames are those in memory, or of its recording. Raises the errors of `document`, and StateError: the board
        type has `MOST_GOOD` good boards.
        """
        with self._lock:
            finished = _checked(self._archive.get(run))
            name = finished.board_type.name
            file = good_file(self._directory, name, run)
            others = tuple(one for one in self._good_files(name) if one[0] != file)
            if len(others) >= MOST_GOOD:
                raise StateError(
                    f"Board type {name!r} has {len(others)} good boards, the largest number.",
                    action="Remove one of them from the good boards first.",
                    code="too-many-good-boards",
                )

            def perform(place: _Place) -> Taught:
                job = TeachJob(**_of(finished, place), good=others, file=file)
                kept: Taught = self._render(job, "good board")
                return kept

            taught = self._with_frames(finished, perform)
        self._events.add("parts", f"The board is kept as a good one of {name!r}.", run=run, state="good")
        absent = [
            ref
            for ref, entry in from_json(self._documents.get(run) or b'{"parts": {}}')["parts"].items()
            if entry.get("presence", 1.0) < _ABSENT
        ]
        doubts = tuple(Disagreement.model_validate(d) for d in taught.disagreements)
        return self.good(name).model_copy(update={"disagreements": doubts, "absent": tuple(absent)})

    def forget(self, run: str) -> GoodBoards:
        """Remove a run from the good boards, and return those that are left; NotFoundError if it is none of them."""
        found = [path for path in self._directory.glob(f"[!.]*/*{ENDING}") if path.name == f"{run}{ENDING}"]
        if not found:
            raise NotFoundError(
                f"Run {run!r} is not one of the good boards.",
                action="See the good boards of the board type.",
                code="not-good",
            )
        found[0].unlink(missing_ok=True)
        self._events.add("parts", "The board is no longer one of the good ones.", run=run, state="not-good")
        return self.good(found[0].parent.name)

    def set_aside(self, board_type: str) -> None:
        """Set the good boards of a board type aside that is deleted."""
        if (directory := self._directory / board_type).is_dir():
            shutil.rmtree(_aside(directory), ignore_errors=True)
            directory.rename(_aside(directory))

    def bring_back(self, board_type: str) -> None:
        """Bring the good boards of a board type back that is restored, beside those that were taught meanwhile."""
        directory = self._directory / board_type
        for path in sorted(_aside(directory).glob(f"*{ENDING}")):
            directory.mkdir(parents=True, exist_ok=True)
            if not (directory / path.name).exists():
                path.rename(directory / path.name)

    def good(self, board_type: str) -> GoodBoards:
        """Return the good boards of a board type."""
        boards = []
        for path, _ in self._good_files(board_type):
            with suppress(FileNotFoundError):  # It was removed meanwhile.
                boards.append(GoodBoard(run=path.name.removesuffix(ENDING), size_bytes=path.stat().st_size))
        return GoodBoards(board_type=board_type, boards=tuple(boards))

    def would_mark(self, board_type: BoardType, limits: BoardLimits, runs: Sequence[str]) -> LimitsReport:
        """Return what limits would have marked on boards of a type, by the measures that are stored of them.

        Raises InputError if the limits name a part or package that the board type does not have.
        """
        packages = {c.address: c.package for c in board_type.components}
        for key, named, known in (
            ("parts", limits.parts, packages.keys()),
            ("packages", limits.packages, set(packages.values())),
        ):
            if unknown := sorted(named.keys() - known):
                raise InputError.field("body", key, unknown[0], f"one that board type {board_type.name!r} has")
        of_part, found, counts = limits.by_part(packages), list[MarkedPart](), Counter[str]()
        for run in runs:
            if (content := self._archive.store.parts(run)) is None:
                continue
            parts = from_json(content)["parts"]
            counts["runs"] += 1
            counts["measured"] += len(parts)
            for address, measure in parts.items():
                if address in of_part and (marked := beyond(of_part[address], measure)):
                    found.append(MarkedPart(run=run, part=address, measures=tuple(marked)))
        return LimitsReport(
            board_type=board_type.name, limits=limits, runs=counts["runs"], measured=counts["measured"],
            marked_parts=len(found), marked_runs=len({one.run for one in found}), marked=tuple(found[:_MOST_NAMED]),
        )  # fmt: skip

    def _good_files(self, board_type: str) -> tuple[tuple[Path, int], ...]:
        """Return the files of the good boards of a type, with the times of their last changes, ns."""
        # Names of imported runs are free texts.
        if not re.fullmatch(STORED_NAME, board_type):
            return ()
        found = []
        for path in sorted((self._directory / board_type).glob(f"*{ENDING}")):
            with suppress(FileNotFoundError):  # It was removed meanwhile.
                found.append((path, path.stat().st_mtime_ns))
        return tuple(found)

    def _with_frames(self, finished: FinishedRun, perform: Callable[[_Place], T]) -> T:
        """Call `perform` with the place of a run's frames: the ring, or its recording; GoneError without either."""
        run = finished.detail.id
        try:
            with self._lease(run, "measures of parts") as bay:
                return perform(_Place(bay.number, bay.generation))
        except GoneError:
            if not (files := recorded_files(self.recorded, run, finished.slots)):
                raise
        return perform(_Place(0, 0, files))

    def _measured(self, finished: FinishedRun, place: _Place, priority: Priority) -> bytes:
        """Have all parts measured, and store their document if there are good boards: without, it is not final."""
        run, good = finished.detail.id, self._good_files(finished.board_type.name)
        job = PartsJob(**_of(finished, place), good=good, priority=priority)
        content: bytes = self._render(job, "parts")
        if not from_json(content)["good_boards"]:
            return self._by_heights.put(f"{run} {good}", content)
        self._archive.store.save_parts(run, content.decode())
        return self._documents.put(run, content)

    def known(self, run: str) -> bytes | None:
        """Return the measures of a run that hold: those with good boards, or by heights until a good board comes."""
        if (found := self._documents.get(run)) is not None:
            return found
        return self._by_heights.get(f"{run} {self._good_files(self._archive.get(run).board_type.name)}")

    def _measure_after(self, run: str) -> None:
        """Measure the parts of a run that has just ended, if it can have measures."""
        try:
            finished = _checked(self._archive.get(run))
            # Without the lock: callers do not wait for spare time. Measuring twice is harmless.
            if self._documents.get(run) is not None:
                return
            bay = self._bay_of(run)
            content = self._measured(finished, _Place(bay.number, bay.generation), Priority.HEIGHTS)
        except (StateError, GoneError, NotFoundError, BusyError):
            return  # It has no result, its frames were needed, or the station stops.
        except Exception as fault:  # noqa: BLE001  the thread must go on: later runs need it
            _log.warning("parts of run %s failed", run, exc_info=True)
            self._events.add("trouble", f"Parts were not measured: {fault}", run=run, code="parts-not-measured")
            return
        self._events.add("parts", event_message(from_json(content)), run=run, state="measured")


def good_file(directory: Path, board_type: str, run: str) -> Path:
    """Return the file of a good board in the directory of all good boards."""
    return directory / board_type / f"{run}{ENDING}"


def _aside(directory: Path) -> Path:
    """Return where the good boards of a deleted board type are; no board type has a name like it."""
    return directory.with_name(f".{directory.name}")


def _checked(finished: FinishedRun) -> FinishedRun:
    """Return a run that can have measures; raise StateError or NotFoundError for another, before a worker is asked."""
    _ = finished.view_calculator, _head(finished)
    if not re.fullmatch(STORED_NAME, finished.board_type.name):
        raise StateError(
            f"Board type {finished.board_type.name!r} of run {finished.detail.id} has a name that cannot be stored.",
            action="Rename it where the run was exported.",
        )
    return finished


def _of(finished: FinishedRun, place: _Place) -> dict[str, Any]:
    """Return what all jobs on the parts of a run have in common."""
    detail = finished.detail
    return {
        "run": detail.id, "bay": place.bay, "generation": place.generation, "files": place.files,
        "board_type": finished.board_type, "stitch": finished.lean, "cameras": finished.cameras,
        "head": _head(finished), "slots": finished.slots, "calibration": detail.calibration,
    }  # fmt: skip


def _head(finished: FinishedRun) -> Any:
    if finished.head is None:
        raise NotFoundError(
            f"Run {finished.detail.id} was cut short, so that its parts are not known.",
            action="Film the board again.",
            code="no-result",
        )
    return finished.head


def event_message(document: dict[str, Any]) -> str:
    """Return the message of the event of measured parts."""
    parts, remarks = document["parts"], dict(zip(document["remark_codes"], document["remarks"], strict=True))
    # Parts of another revision are no faults of this board.
    if "other-revision" in remarks:
        return str(remarks["other-revision"])
    said = {ref: entry["presence"] for ref, entry in parts.items() if "presence" in entry}
    text = f"{len(said)} of {len(parts)} parts are measured"
    for what, found in (
        ("look absent", [ref for ref, p in said.items() if p < _ABSENT]),
        ("are beyond limits", [ref for ref, entry in parts.items() if "marked" in entry]),
    ):
        if found:
            text += f", {len(found)} of them {what}: {', '.join(found[:5])}{' …' if len(found) > 5 else ''}"
    if others := [remark for code, remark in remarks.items() if code != "few-good-boards"]:
        text += f"; {others[-1]}"
    return f"{text.removesuffix('.')}."

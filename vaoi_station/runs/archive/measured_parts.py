"""Parts of finished runs: measured by workers after each run of a taught board type, or on request, and stored.

What good boards look like is kept in one file for each of them, in a directory for each board type: a board is removed
from the good ones, or taken over from another station, with its file.
"""

from __future__ import annotations

import json
import logging
import re
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

from vaoi_station.errors import BusyError, GoneError, InputError, NotFoundError, StateError
from vaoi_station.model import BoardLimits, BoardType
from vaoi_station.model.board_type import STORED_NAME
from vaoi_station.model.part_limits import beyond
from vaoi_station.parts.learned import ENDING
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.archive.kept_documents import KeptDocuments
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
from vaoi_station.runs.workers.parts_jobs import MOST_GOOD, PartsJob, Taught, TeachJob
from vaoi_station.supervised_queue import SupervisedQueue

_log = logging.getLogger(__name__)

DIRECTORY = "good-boards"
_KEPT = 16
"""Number of runs whose document is kept in memory."""
_MOST_WAITING = 8
"""Largest number of runs that wait for their parts to be measured; the oldest ones are then not measured."""
_MOST_NAMED = 500
"""Largest number of parts that the report about limits names."""
_ABSENT = 0.5
"""Probability of presence below which a part counts as absent in messages."""


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
        self._documents = KeptDocuments(archive.store.parts, _KEPT)
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
            GoneError: the frames are no longer in memory, and the parts were not measured while they were.
        """
        if (found := self._documents.get(run)) is not None:
            return found
        # Of a run without frames it is said at once.
        _checked(self._archive.get(run))
        self._bay_of(run)
        with self._lock:
            if (found := self._documents.get(run)) is not None:
                return found
            finished = _checked(self._archive.get(run))
            with self._lease(run, "measures of parts") as bay:
                return self._measured(finished, bay, Priority.RENDER)

    def teach(self, run: str) -> GoodBoards:
        """Keep a run as that of a good board of its type, and return the good boards.

        Raises the errors of `document`, and StateError: the board type has `MOST_GOOD` good boards.
        """
        with self._lock:
            finished = _checked(self._archive.get(run))
            name = finished.board_type.name
            file = self._directory / name / f"{run}{ENDING}"
            others = tuple(one for one in self._good_files(name) if one[0] != file)
            if len(others) >= MOST_GOOD:
                raise StateError(
                    f"Board type {name!r} has {len(others)} good boards, the largest number.",
                    action="Remove one of them from the good boards first.",
                    code="too-many-good-boards",
                )
            with self._lease(run, "teaching of parts") as bay:
                job = TeachJob(
                    run, bay.number, bay.generation, finished.board_type, finished.lean, finished.cameras,
                    _head(finished), finished.slots, finished.detail.calibration, others, file,
                )  # fmt: skip
                taught: Taught = self._render(job, "good board")
        self._events.add("parts", f"The board is kept as a good one of {name!r}.", run=run, state="good")
        absent = [
            ref
            for ref, entry in json.loads(self._documents.get(run) or b'{"parts": {}}')["parts"].items()
            if entry.get("presence", 1.0) < _ABSENT
        ]
        doubts = tuple(Disagreement.model_validate(d) for d in taught.disagreements)
        return self.good(name).model_copy(update={"disagreements": doubts, "absent": tuple(absent)})

    def forget(self, run: str) -> GoodBoards:
        """Remove a run from the good boards, and return those that are left; NotFoundError if it is none of them."""
        found = [path for path in self._directory.glob(f"*/*{ENDING}") if path.name == f"{run}{ENDING}"]
        if not found:
            raise NotFoundError(
                f"Run {run!r} is not one of the good boards.",
                action="See the good boards of the board type.",
                code="not-good",
            )
        found[0].unlink(missing_ok=True)
        self._events.add("parts", "The board is no longer one of the good ones.", run=run, state="not-good")
        return self.good(found[0].parent.name)

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
            parts = json.loads(content)["parts"]
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

    def _measured(self, finished: FinishedRun, bay: Bay, priority: Priority) -> bytes:
        """Have all parts measured, and store their document if there are good boards: without, it is not final."""
        run, good = finished.detail.id, self._good_files(finished.board_type.name)
        job = PartsJob(
            run, bay.number, bay.generation, finished.board_type, finished.lean, finished.cameras, _head(finished),
            finished.slots, finished.detail.calibration, good, priority=priority,
        )  # fmt: skip
        content: bytes = self._render(job, "parts")
        if good:
            self._documents.put(run, content)
            self._archive.store.save_parts(run, content.decode())
        return content

    def _measure_after(self, run: str) -> None:
        """Measure the parts of a run that has just ended, if it can have measures."""
        try:
            finished = _checked(self._archive.get(run))
            # Without the lock: callers do not wait for spare time. Measuring twice is harmless.
            if self._documents.get(run) is not None:
                return
            content = self._measured(finished, self._bay_of(run), Priority.HEIGHTS)
        except (StateError, GoneError, NotFoundError, BusyError):
            return  # It has no result, its frames were needed, or the station stops.
        except Exception as fault:  # noqa: BLE001  the thread must go on: later runs need it
            _log.warning("parts of run %s failed", run, exc_info=True)
            self._events.add("trouble", f"Parts were not measured: {fault}", run=run, code="parts-not-measured")
            return
        self._events.add("parts", event_message(json.loads(content)), run=run, state="measured")


def _checked(finished: FinishedRun) -> FinishedRun:
    """Return a run that can have measures; raise StateError or NotFoundError for another, before a worker is asked."""
    _ = finished.view_calculator, _head(finished)
    if not re.fullmatch(STORED_NAME, finished.board_type.name):
        raise StateError(
            f"Board type {finished.board_type.name!r} of run {finished.detail.id} has a name that cannot be stored.",
            action="Rename it where the run was exported.",
        )
    return finished


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

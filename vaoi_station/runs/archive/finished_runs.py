"""The archive of finished runs: all are in the database, the latest also in memory. Callers can wait for the next run.

A finished run is announced once its result is on disk: callers that wait for it are woken, and an event is published.
If the disk refuses the result, the run is announced from memory, its document states this (`stored`), and the result is
written as soon as the disk accepts it. What only explains the verdict is added a moment later (`Archive.explain`).
"""

from __future__ import annotations

import contextlib
import threading
import time
from bisect import bisect_left
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping, Sequence, Set
from concurrent.futures import Future, wait
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError, GoneError, NotFoundError, StateError, VaoiError
from vaoi_station.files.results import without_components
from vaoi_station.geometry import Camera
from vaoi_station.identity.comparison import compare
from vaoi_station.model import BoardType, Calibration, FrameRecord, RecordingHead, Stitch
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.photometry.flat_fields import fitting_balances
from vaoi_station.rendering import FrameFacts, ViewCalculator
from vaoi_station.runs.archive import stored_documents
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.storage_watch import StorageWatch
from vaoi_station.runs.archive.stored_documents import in_state
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import detail_of, summary_of, timeline_of
from vaoi_station.runs.run.verdict import RunVerdict, identified
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import RunDetail, RunSummary, Timeline
from vaoi_station.runs.states.tables import IN_MEMORY, RUN, RunState, RunStep
from vaoi_station.store import RunRow, Store

EXPLAINED_S = 2.0
"""Longest wait of callers that need a complete result of a run that has just ended, s."""
CACHED_RUNS = 32
"""Number of finished runs that are kept in memory with their documents parsed."""


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """The complete record of a run that has ended; every change makes another object."""

    detail: RunDetail
    finish_number: int
    board_type: BoardType
    cameras: tuple[Camera, ...]
    stitch: Stitch | None
    """The result without its tables of components; None, as `document`, if the run ended without a result."""
    document: str | None
    """The result as JSON text; complete once the run is explained."""
    timeline: Timeline
    head: RecordingHead | None
    """Head of the run's recording; None if the station ended while the board was filmed."""
    before: RunVerdict
    """The verdict without the identity of the board."""
    identity: IdentityDocument | None
    """Which board it shows; None if its boards have no codes."""
    flat_fields: Path | None = None
    """Directory of the station's flat fields."""

    @cached_property
    def view_calculator(self) -> ViewCalculator:
        """Calculator of component views. Raises `StateError` without CAD mapping, `NotFoundError` without result."""
        return ViewCalculator(self.board_type, self.lean, self.cameras)

    @property
    def lean(self) -> Stitch:
        """The result without its tables of components. Raises `NotFoundError` if the run ended without a result."""
        return self.stitch or self.result

    @property
    def complete(self) -> bool:
        """Whether the result has all its entries."""
        return self.stitch is None or "later" not in self.stitch.quality

    @cached_property
    def result(self) -> Stitch:
        """The result with its tables. Raises `NotFoundError` if the run ended without a result."""
        return Stitch.model_validate_json(self.text)

    @property
    def text(self) -> str:
        """The result as JSON text. Raises `NotFoundError` with the reasons if the run ended without result."""
        if self.document is None:
            raise NotFoundError(
                f"Run {self.detail.id} ended without a result: "
                + "; ".join(reason.message for reason in self.detail.reasons),
                action="Its frames are available while they are in memory.",
                code="no-result",
            )
        return self.document

    @cached_property
    def frame_records(self) -> Mapping[tuple[int, int], FrameRecord]:
        """The record of each frame (camera, row)."""
        return {(f.camera, f.row): f for f in self.detail.frames}

    @cached_property
    def usable_frames(self) -> Set[tuple[int, int]]:
        """The frames (camera, row) that may give a view."""
        # Incomplete frames have matrices too, but the areas of their missing packets are black. The matrix of a frame
        # that is not proven may be that of another row. So neither kind of frame gives a view.
        return frozenset(key for key, frame in self.frame_records.items() if frame.usable)

    @cached_property
    def slots(self) -> Mapping[tuple[int, int], int]:
        """The slots of the usable frames (camera, row)."""
        return {k: f.slot for k, f in self.frame_records.items() if f.usable and f.slot is not None}

    @cached_property
    def frame_facts(self) -> Mapping[tuple[int, int], FrameFacts]:
        """How each frame (camera, row) was taken."""
        times_s = self.head.row_times_s().tolist() if self.head else []
        since_s = dict(enumerate(time_s - times_s[0] for time_s in times_s))
        balances = fitting_balances(self.flat_fields, self.head)
        return {
            key: FrameFacts(
                f.exposure_us, f.gain, f.light or None, since_s.get(f.row), balances.get((f.camera, f.light or None))
            )
            for key, f in self.frame_records.items()
        }


class Archive:
    """The finished runs of the station and their results. Its methods may be called from any thread.

    Runs that are not on disk yet stay in memory until they are.
    """

    def __init__(self, store: Store, events: EventLog, flat_fields: Path | None = None) -> None:
        self.store, self._events, self._flat_fields = store, events, flat_fields
        self.storage = StorageWatch(store, events, self.count_unstored)
        self.keep_s = 0.0
        """Time from the announcement of a run during which its frames are not evicted, s."""
        self.on_announced: Callable[[str, float], None] = lambda _run, _until_s: None
        """Function that is called when a run is announced, with its id and the host time until which it is kept."""
        self.statistics = RunStatistics()
        self.on_finished: Callable[[RunDetail], None] = lambda _detail: None
        """Function that is called before a run is announced, with its document. It must return at once."""
        self.on_explained: Callable[[str], None] = lambda _run: None
        """Function that is called with a run once its result is complete, or stays as it is. It must return at once."""
        self.retention, self.search, self.identities, self.figures = (
            store.retention, store.search, store.identities, store.figures
        )  # fmt: skip
        self._changed = threading.Condition()
        self._recent: OrderedDict[str, FinishedRun] = OrderedDict()
        self._under_way: set[str] = set()
        self._unexplained: set[str] = set()
        """Finished runs whose result is still being completed."""
        self._unstored: dict[str, FinishedRun] = {}
        """Finished runs that are not on disk yet, oldest first."""
        self._unannounced: dict[str, int] = {}
        """Finish numbers of the runs that have not been announced, oldest first."""
        self._announcing = threading.Lock()
        """Held while runs are announced, so that this is in their order, whichever thread does it."""
        last = store.last_finished()
        # Without the history, numbers begin above all that it can have: it counts runs, this counts seconds.
        self._finished = int(time.time()) if store.database.history_unread else last.finish_number or 0 if last else 0
        """Highest finish number that was given to a run. That run may not have been announced yet."""
        self._before = self._finished
        """Highest finish number before this start. Frames of runs up to it are gone, whatever the database states."""
        self._announced = self._finished
        self._closed = False
        self._close_unfinished()

    def begin(self, progress: Progress) -> None:
        """Store the record of a run that has begun, so that it is known even if the station crashes during the run."""
        with self._changed:
            self._under_way.add(progress.run)
        self.store.save_run(stored_documents.row_of(progress, detail_of(progress)))

    def finish(self, progress: Progress) -> RunDetail:
        """Store a run that has ended, and return its document. The run is announced once it is written."""
        self._finished += 1
        own, order = detail_of(progress), progress.order
        before = RunVerdict(own.verdict, own.reasons)
        # It is written with the run: if the station ends before the codes are read, its board does not count as known.
        wanted = order.board_type.identity
        identity = None if wanted is None else compare(wanted, None, own.board_id, without="pending")
        detail, document = identified(own, before, identity), progress.result.document if progress.result else None
        finished = FinishedRun(
            detail, self._finished, order.board_type, order.setup.cameras, progress.stitch, document,
            timeline_of(progress), progress.head, before, identity, self._flat_fields,
        )  # fmt: skip
        # The run is put into memory before it is written: callers get its result while the disk is still busy, and even
        # if the disk refuses the result.
        with self._changed:
            self._under_way.discard(progress.run)
            self._unstored[progress.run] = finished
            self._unannounced[progress.run] = finished.finish_number
            if not finished.complete:
                self._unexplained.add(progress.run)
            self._cache(finished)
        self.statistics.add(detail, finished.timeline)
        stored = detail.model_copy(update={"stored": True})
        row = stored_documents.row_of(progress, stored, self._finished, identity)
        saved = self.store.save_run(row, finished.timeline.model_dump_json(), finished.document)
        saved.add_done_callback(lambda future: self._written(finished, future))
        return detail

    def explain(self, run: str, document: str | None, why: str = "") -> None:
        """Put the complete result of a finished run in place of the first one; None: it will never come, and `why`."""
        try:
            with contextlib.suppress(VaoiError):  # it may have been deleted meanwhile
                self._explain(self.get(run), document, why)
        finally:
            with self._changed:  # after the complete result is in place, which callers wait for
                self._unexplained.discard(run)
                self._changed.notify_all()
            self.on_explained(run)

    def _explain(self, read: FinishedRun, document: str | None, why: str) -> None:
        run = read.detail.id
        with self._changed:
            finished = self._in_memory(run) or read
            if finished.complete:
                return
            if document is not None:
                quality = {key: value for key, value in finished.lean.quality.items() if key != "later"}
                lean = finished.lean.model_copy(update={"quality": quality})
                self._cache(replace(finished, document=document, stitch=lean))
                saved = self.store.complete_result(run, document)
                saved.add_done_callback(partial(self._completed, run))
        if document is None:
            message = f"The tables that explain the verdict are missing: {why}"
            action = "Matrices and verdict are complete. For the tables, stitch the recording of the run."
            self._events.add("trouble", message, run=run, code="explanation-lost", action=action)
        else:
            message = "The result is complete: pairs of links, covariances and heights are there too."
            # Without its state: for those who wait for runs, a run has ended once.
            self._events.add("run", message, run=run, code="explained")

    def _completed(self, run: str, saved: Future[None]) -> None:
        if (fault := saved.exception()) is not None:
            message = f"The complete result of run {run} could not be written: {fault}"
            self._events.add("trouble", message, run=run, code="store")

    def explained(self, run: str, longest_s: float = EXPLAINED_S) -> FinishedRun:
        """Return a finished run as `get` does, with its complete result; wait for that if it has ended just now."""
        with self._changed:
            self._changed.wait_for(lambda: not self.awaits_explanation(run) or self._closed, longest_s)
        return self.get(run)

    def awaits_explanation(self, run: str) -> bool:
        """Return whether the result of a finished run is still being completed."""
        return run in self._unexplained

    def tick(self) -> None:
        """Announce runs from memory while the storage is in trouble. The coordinator calls this every tick."""
        self.storage.tick()
        if self._unannounced and self.storage.in_trouble:
            self._announce(self._finished)

    def calibration_of(self, finished: FinishedRun) -> Calibration:
        """Return the calibration with which a run was stitched."""
        return Calibration.model_validate_json(self.store.document(finished.detail.calibration))

    def mark(self, run: str, step: RunStep) -> None:
        """Record that the frames of a finished run were released or evicted; `step` states which."""
        read = self.get(run)
        with self._changed:
            finished = self._in_memory(run) or read
            state = RUN.next(finished.detail.state, step)
            self._cache(replace(finished, detail=in_state(finished.detail, state)))
            self.store.set_state(run, state)

    def identify(self, run: str, identity: IdentityDocument) -> Future[None]:
        """Store the identity of the board of a finished run, and the verdict that it leaves."""
        read = self.get(run)
        with self._changed:
            finished = self._in_memory(run) or read
            detail = identified(finished.detail, finished.before, identity)
            self._cache(replace(finished, detail=detail, identity=identity))
            summary = summary_of(detail.model_copy(update={"stored": True})).model_dump_json()
            return self.store.identities.save(run, stored_documents.identity_row(identity), summary, detail.state)

    def get(self, run: str) -> FinishedRun:
        """Return a finished run by its id.

        Raises:
            NotFoundError: the id is unknown.
            StateError: the run has not ended.
            GoneError: at most a summary of the run is kept.
            DeviceError: the disk refused the result, and the run is no longer in memory.
        """
        known = self._cached(run)
        if known is not None:
            return known
        row = self.store.run(run)
        if row is None and not self.store.retention.forgotten(run):
            # Of all addresses below "runs" only runs/latest itself takes this word.
            action = "See the list of runs; the document of runs/latest has the id of the newest."
            raise NotFoundError(f"There is no run {run!r}.", action=action, code="unknown-run")
        if row is None or (row.finish_number is not None and not row.detail):
            raise GoneError(
                f"Result and record of run {run} were deleted because of their age, number or size.",
                action="Fetch results sooner, pin runs that are needed for long, or raise the limits of [keep].",
                code="run-forgotten",
            )
        # A row without a finish number was written when the run began, but not again when the run ended.
        if row.finish_number is None:
            if (known := self._cached(run)) is not None:  # The run ended between the two look-ups.
                return known
            raise DeviceError(f"The end of run {run} could not be written.", action="Check space on the data disk.")
        finished = self._parsed(row)
        with self._changed:
            return self._in_memory(run) or self._cache(finished)

    def _cached(self, run: str) -> FinishedRun | None:
        """Return a finished run if it is in memory. Raise StateError if the run has not ended."""
        with self._changed:
            if run in self._under_way:
                raise StateError(f"Run {run} has no result yet.", action="Wait for it by runs/next.")
            return self._in_memory(run)

    def _in_memory(self, run: str) -> FinishedRun | None:
        return self._unstored.get(run) or self._recent.get(run)

    def _numbered(self, finish_number: int) -> FinishedRun | None:
        """Return the finished run with this finish number if it is in memory, else None."""
        runs = (*self._recent.values(), *self._unstored.values())
        return next((run for run in runs if run.finish_number == finish_number), None)

    def count_unstored(self) -> int:
        """Return the number of finished runs that are in memory only."""
        return len(self._unstored)

    def count_at_risk(self) -> int:
        """Return the number of runs that an end of the station would lose if the disk refuses writes."""
        with self._changed:
            return len(self._unstored) + len(self._under_way)

    def latest(self) -> FinishedRun | None:
        """Return the run that was announced last; None if no run was announced yet."""
        with self._changed:
            announced = self._numbered(self._announced)
        if announced is not None:
            return announced
        row = self.store.last_finished()
        return None if row is None else self.get(row.id)

    def next(self, after: str | None, timeout_s: float) -> FinishedRun | None:
        """Return the first run that is announced after the run `after` (None: after this call); None if there is none
        for `timeout_s`.
        """
        number = self._announced if after is None else self._number_of(after)
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while self._announced <= number and not self._closed:
                if not self._changed.wait(deadline - time.monotonic()) and time.monotonic() >= deadline:
                    return None
            if self._announced <= number:
                return None
            kept = self._numbered(number + 1)
        if kept is not None:
            return kept
        row = self.store.finished_after(number)
        return None if row is None else self.get(row.id)

    def list(self, limit: int, before: str | None) -> list[RunSummary]:
        """Return the summaries of at most `limit` runs, newest first, below the id `before` (None: all)."""
        # These are read before the rows, so that a run which is written meanwhile is in at least one of the two.
        unstored = {run.id: run for run in self.unstored() if before is None or run.id < before}
        found = self._summaries(self.store.runs(limit, before)) | unstored
        return [found[run] for run in sorted(found, reverse=True)[:limit]]

    def summaries(self, runs: Sequence[str]) -> dict[str, RunSummary]:
        """Return the summaries of the stored runs with these ids, by id."""
        return self._summaries(self.store.chosen_runs(runs))

    def unstored(self) -> tuple[RunSummary, ...]:
        """Return the summaries of the finished runs that are in memory only, newest first."""
        with self._changed:
            return tuple(summary_of(self._unstored[run].detail) for run in sorted(self._unstored, reverse=True))

    def close(self) -> None:
        """Wake all callers that wait for a run, because no more runs will end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _close_unfinished(self) -> None:
        """Update the runs from before a restart of the station: unfinished runs failed, and all frames are gone."""
        saved: dict[Future[Any], RunRow | None] = {}
        for row in self.store.unfinished():
            self._finished += 1
            cut = stored_documents.cut_short(row, self._finished)
            saved[self.store.save_run(cut)] = cut
        saved[self.store.mark_frames_gone(RunState.GONE)] = None
        self._before = self._announced = self._finished
        # Awaited, so that later calls read what was written. A disk that takes nothing does not keep the station from
        # filming: until it does, the runs are in memory as they are.
        while wait(saved, timeout=0.05).not_done and self.store.database.trouble is None:
            pass
        for future, waiting in saved.items():
            if future.done():
                future.result()
            elif waiting is not None:
                self._keep_in_memory(waiting, future)

    def _keep_in_memory(self, row: RunRow, saved: Future[Any]) -> None:
        """Keep the record of an earlier run in memory until the disk takes it, if it can be read."""

        def forget(_: Future[Any]) -> None:
            with self._changed:
                self._unstored.pop(row.id, None)

        with contextlib.suppress(VaoiError, ValueError):
            earlier = self._parsed(row)
            self._unstored[row.id] = replace(earlier, detail=earlier.detail.model_copy(update={"stored": False}))
            saved.add_done_callback(forget)

    def _written(self, finished: FinishedRun, saved: Future[None]) -> None:
        """Announce a run that is on disk, or that can never be written. `saved` is the completed write."""
        run, fault = finished.detail.id, saved.exception()
        if fault is not None:
            self._events.add("trouble", f"Run {run} could not be written: {fault}", run=run, code="store")
        with self._changed:
            late = run not in self._unannounced
            known = self._unstored.pop(run, finished)
            if fault is None:
                known = replace(known, detail=known.detail.model_copy(update={"stored": True}))
            self._cache(known)
        if fault is None and late:
            self._events.add("run", "The result is on disk now.", run=run, code="stored")
        self._announce(finished.finish_number)

    def _announce(self, finish_number: int) -> None:
        """Announce all finished runs up to a finish number, in the order in which they ended."""
        with self._announcing:
            with self._changed:
                due = [run for run, number in self._unannounced.items() if number <= finish_number]
                waiting = [found for run in due if (found := self._in_memory(run)) is not None]
                for run in due:
                    del self._unannounced[run]
            for finished in waiting:
                self._announce_one(finished)

    def _announce_one(self, finished: FinishedRun) -> None:
        """Wake the callers that wait for this run, and publish its event."""
        run = finished.detail.id
        self.on_finished(finished.detail)
        # From here on callers can know of the run, so from here on its frames are kept for the stated time.
        until_s = time.monotonic() + self.keep_s
        # Before callers are woken: one that arms at once needs the memory that this run no longer needs.
        self.on_announced(run, until_s)
        with self._changed:
            detail = (latest := self._in_memory(run) or finished).detail
            if detail.frames_available:
                detail = detail.model_copy(update={"frames_kept_until": utc_of_host(until_s)})
                self._cache(replace(latest, detail=detail))
            self._announced = finished.finish_number
            self._changed.notify_all()
        message = "; ".join(reason.message for reason in detail.reasons) or "The matrices are available."
        if detail.timings is not None and (ms := detail.timings.ready_after_last_frame_ms) is not None:
            message += f" {ms:.0f} ms after the last frame."
        if not detail.stored:
            message += " It is not on disk yet."
        self._events.add("run", message, state=finished.detail.state, run=run)

    def _number_of(self, run: str) -> int:
        """Return the finish number of a run; 0 for an imported one, which is older than all runs of this station.

        For a run that has not ended, return that of the latest announced run.
        """
        try:
            return max(self.get(run).finish_number, 0)
        except StateError:
            return self._announced
        except GoneError:
            # A caller that was away for long continues with the oldest run that is still kept.
            row = self.store.run(run)
            return max(row.finish_number or 0, 0) if row else 0

    def _cache(self, finished: FinishedRun) -> FinishedRun:
        if finished.detail.id in self._unstored:
            self._unstored[finished.detail.id] = finished
        self._recent[finished.detail.id] = finished
        self._recent.move_to_end(finished.detail.id)
        while len(self._recent) > CACHED_RUNS:
            self._recent.popitem(last=False)
        return finished

    def _state_of(self, row: RunRow) -> RunState:
        """Return the present state of a stored run; the disk may not have taken yet that its frames are gone."""
        state = stored_documents.state_of(row)
        earlier = row.finish_number is not None and row.finish_number <= self._before
        return RunState.GONE if earlier and state in IN_MEMORY else state

    def _summaries(self, rows: Sequence[RunRow]) -> dict[str, RunSummary]:
        return {row.id: stored_documents.summary(row, self._state_of(row)) for row in rows}

    def _parsed(self, row: RunRow) -> FinishedRun:
        with stored_documents.readable(row.id):
            calibration = Calibration.model_validate_json(self.store.document(row.calibration_digest))
            result, timeline = self.store.result(row.id), self.store.timeline(row.id)
            head = RecordingHead.model_validate_json(row.head) if row.head else None
            own = RunDetail.model_validate_json(row.detail)
            return FinishedRun(
                detail=in_state(stored_documents.decided(row.detail, row.summary), self._state_of(row)),
                finish_number=row.finish_number or 0,
                board_type=BoardType.model_validate_json(self.store.document(row.board_type_digest)),
                cameras=calibration.cameras(head.cameras) if head else (),
                stitch=without_components(Stitch.model_validate_json(result)) if result else None,
                document=result,
                timeline=Timeline.model_validate_json(timeline) if timeline else _EMPTY,
                head=head,
                before=RunVerdict(own.verdict, own.reasons),
                identity=stored_documents.identity(self.store.identities.document(row.id)),
                flat_fields=self._flat_fields,
            )


_EMPTY = Timeline(frames_settled_s=(), tasks=(), last_frame_s=0.0, ready_s=None)


LATENCY_BOUNDS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Upper bounds, s, of the classes into which the times from the last frame to the result are counted."""


@dataclass
class RunFigures:
    """The counts and waiting times of runs."""

    verdicts: dict[str, int] = field(default_factory=Counter)
    """Number of runs for each verdict; `none` for runs without a result."""
    frames: dict[str, int] = field(default_factory=Counter)
    """Number of frames for each verdict of a frame."""
    latencies: list[int] = field(default_factory=lambda: [0] * (len(LATENCY_BOUNDS_S) + 1))
    """Number of results in each class of `LATENCY_BOUNDS_S`; the last class is above all bounds."""
    latency_sum_s: float = 0.0


class RunStatistics:
    """Adds up the figures of runs. Its methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock, self._figures = threading.Lock(), RunFigures()

    def add(self, detail: RunDetail, timeline: Timeline) -> None:
        """Count a run that has ended."""
        with self._lock:
            figures = self._figures
            figures.verdicts[str(detail.verdict) if detail.verdict else "none"] += 1
            for verdict, count in detail.counts.model_dump().items():
                figures.frames[verdict] += count
            if timeline.ready_s is not None:
                waited_s = max(timeline.ready_s - timeline.last_frame_s, 0.0)
                figures.latencies[bisect_left(LATENCY_BOUNDS_S, waited_s)] += 1
                figures.latency_sum_s += waited_s

    def figures(self) -> RunFigures:
        """Return the counts and waiting times up to now."""
        with self._lock:
            return deepcopy(self._figures)

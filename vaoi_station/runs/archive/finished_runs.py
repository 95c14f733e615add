"""The archive of finished runs. All are in the database, the latest also in memory; callers can wait for the next run.

A finished run is announced (callers that wait for it are woken, and an event is published) once its result was written.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

from vaoi_station.errors import DeviceError, GoneError, NotFoundError, StateError
from vaoi_station.files.results import without_components
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Calibration, RecordingHead, Stitch
from vaoi_station.rendering import ViewCalculator
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.run_statistics import RunStatistics
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import detail_of, summary_of, timeline_of
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import Reason, RunDetail, RunSummary, Timeline
from vaoi_station.runs.states.tables import IN_MEMORY, RUN, RunState, RunStep
from vaoi_station.store import RunRow, Store

R = TypeVar("R", RunSummary, RunDetail)
CACHED_RUNS = 32
"""Number of finished runs that are kept in memory with their documents parsed."""


@dataclass(frozen=True)
class FinishedRun:
    """The complete record of a run that has ended."""

    detail: RunDetail
    finish_number: int
    board_type: BoardType
    cameras: tuple[Camera, ...]
    stitch: Stitch | None
    """The result without its tables of components; None if the run ended without a result."""
    document: str | None
    """The complete result as JSON text; None if the run ended without a result."""
    timeline: Timeline
    head: RecordingHead | None
    """Head of the run's recording; None if the station ended while the board was filmed."""

    @cached_property
    def view_calculator(self) -> ViewCalculator:
        """Calculator of component views. Raises `StateError` without CAD mapping, `NotFoundError` without result."""
        return ViewCalculator(self.board_type, self.stitch or self.result, self.cameras)

    @cached_property
    def result(self) -> Stitch:
        """The complete result. Raises `NotFoundError` if the run ended without a result."""
        return Stitch.model_validate_json(self.text)

    @property
    def text(self) -> str:
        """The complete result as JSON text. Raises `NotFoundError` with the reasons if the run ended without result."""
        if self.document is None:
            raise NotFoundError(
                f"Run {self.detail.id} ended without a result: "
                + "; ".join(reason.message for reason in self.detail.reasons),
                action="Its frames are available while they are in memory.",
                code="no-result",
            )
        return self.document


class Archive:
    """The finished runs of the station and their results. Its methods may be called from any thread.

    A run is announced when its result is on disk, or when the disk has refused it.
    """

    def __init__(self, store: Store, events: EventLog) -> None:
        self._store = store
        self._events = events
        self.keep_s = 0.0
        """Time from the announcement of a run during which its frames are not evicted, s."""
        self.on_announced: Callable[[str, float], None] = lambda _run, _until_s: None
        """Function that is called when a run is announced, with its id and the host time until which it is kept."""
        self.statistics = RunStatistics()
        self.on_finished: Callable[[RunDetail], None] = lambda _detail: None
        """Function that is called before a run is announced, with its document. It must return at once."""
        self.retention = store.retention
        self._changed = threading.Condition()
        self._recent: OrderedDict[str, FinishedRun] = OrderedDict()
        self._under_way: set[str] = set()
        last = store.last_finished()
        self._finished = last.finish_number or 0 if last else 0
        """Highest finish number that was given to a run. That run may not have been announced yet."""
        self._announced = self._finished
        self._closed = False
        self._close_unfinished()

    def begin(self, progress: Progress) -> None:
        """Store the record of a run that has begun, so that it is known even if the station crashes during the run."""
        with self._changed:
            self._under_way.add(progress.run)
        self._store.save_run(_row(progress, detail_of(progress), None))

    def finish(self, progress: Progress) -> RunDetail:
        """Store a run that has ended, and return its document. The run is announced after it was written."""
        self._finished += 1
        detail, order = detail_of(progress), progress.order
        finished = FinishedRun(
            detail,
            self._finished,
            order.board_type,
            order.setup.cameras,
            progress.stitch,
            progress.result.document if progress.result else None,
            timeline_of(progress),
            progress.head,
        )
        # The run is put into memory before it is written: callers get its result while the disk is still busy, and even
        # if the disk refuses the result.
        with self._changed:
            self._under_way.discard(progress.run)
            self._cache(finished)
        row = _row(progress, detail, self._finished)
        self.statistics.add(detail, finished.timeline)
        saved = self._store.save_run(row, finished.timeline.model_dump_json(), finished.document)
        saved.add_done_callback(lambda future: self._announce(finished, future))
        return detail

    def calibration_of(self, finished: FinishedRun) -> Calibration:
        """Return the calibration with which a run was stitched."""
        return Calibration.model_validate_json(self._store.document(finished.detail.calibration))

    def mark(self, run: str, step: RunStep) -> None:
        """Record that the frames of a finished run were released or evicted; `step` states which."""
        finished = self.get(run)
        state = RUN.next(finished.detail.state, step)
        with self._changed:
            self._cache(replace(finished, detail=_in_state(finished.detail, state)))
        self._store.set_state(run, state)

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
        row = self._store.run(run)
        if row is None:
            if self._store.retention.forgotten(run):
                raise _forgotten(run)
            raise NotFoundError(f"There is no run {run!r}.", action="See the list of runs.", code="unknown-run")
        # A row without a finish number was written when the run began, but not again when it ended.
        if row.finish_number is None:
            if (known := self._cached(run)) is not None:  # it ended between the two look-ups
                return known
            raise DeviceError(f"The end of run {run} could not be written.", action="Check space on the data disk.")
        if not row.detail:
            raise _forgotten(run)
        finished = self._parsed(row)
        with self._changed:
            return self._recent.get(run) or self._cache(finished)

    def _cached(self, run: str) -> FinishedRun | None:
        """Return a finished run if it is in memory, else None. Raise StateError if the run has not ended."""
        with self._changed:
            if run in self._under_way:
                raise StateError(f"Run {run} has no result yet.", action="Wait for it by runs/next.")
            return self._recent.get(run)

    def latest(self) -> FinishedRun | None:
        """Return the run that was announced last; None if no run was announced yet."""
        with self._changed:
            announced = [d for d in self._recent.values() if d.finish_number == self._announced]
        if announced:
            return announced[0]
        row = self._store.last_finished()
        return None if row is None else self.get(row.id)

    def next(self, after: str | None, timeout_s: float) -> FinishedRun | None:
        """Return the first run that is announced after the run `after`; None if `timeout_s` passes without one.

        If `after` is None, return the first run that is announced after this call.
        """
        number = self._announced if after is None else self._number_of(after)
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while self._announced <= number and not self._closed:
                if not self._changed.wait(deadline - time.monotonic()) and time.monotonic() >= deadline:
                    return None
            if self._announced <= number:
                return None
            kept = [d for d in self._recent.values() if d.finish_number == number + 1]
        if kept:
            return kept[0]
        row = self._store.finished_after(number)
        return None if row is None else self.get(row.id)

    def list(self, limit: int, before: str | None) -> list[RunSummary]:
        """Return summaries of at most `limit` runs, finished or not, newest first.

        If `before` is given, return only runs older than the run with this id.
        """
        return [
            _in_state(RunSummary.model_validate_json(row.summary), RunState(row.state)).model_copy(
                update={"forgotten": not row.detail}
            )
            for row in self._store.runs(limit, before)
        ]

    def close(self) -> None:
        """Wake all callers that wait for a run, because no more runs will end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _close_unfinished(self) -> None:
        """Update the runs from before a restart of the station: unfinished runs failed, and all frames are gone."""
        lost = Reason(code="station-restarted", message="The station ended before this run had a result.")
        for row in self._store.unfinished():
            self._finished += 1
            state = RUN.next(RUN.next(RunState(row.state), RunStep.STATION_LOST), RunStep.MEMORY_TAKEN)
            detail = RunDetail.model_validate_json(row.detail)
            detail = _in_state(detail, state).model_copy(update={"reasons": (*detail.reasons, lost)})
            self._store.save_run(
                replace(
                    row,
                    state=state,
                    finish_number=self._finished,
                    summary=summary_of(detail).model_dump_json(),
                    detail=detail.model_dump_json(),
                )
            )
        self._store.mark_frames_gone(RunState.GONE).result()
        self._announced = self._finished

    def _announce(self, finished: FinishedRun, saved: Future[None]) -> None:
        """Wake callers that wait for a run, and publish its event. `saved` is the completed write of the run.

        The database completes writes in their order, so runs are announced in the order in which they ended.
        """
        fault = saved.exception()
        # A full disk must not hide a result: the run is announced nevertheless, and its result is served from memory.
        if fault is not None:
            self._events.add(
                "trouble",
                f"Run {finished.detail.id} could not be written: {fault}",
                run=finished.detail.id,
                code="store",
            )
        self.on_finished(finished.detail)
        # From here on callers learn of the run, so from here on its frames are kept for the stated time.
        until_s = time.monotonic() + self.keep_s
        # Before callers are woken: a caller that arms at once must find memory that is no longer kept.
        self.on_announced(finished.detail.id, until_s)
        with self._changed:
            latest = self._recent.get(finished.detail.id, finished)
            if latest.detail.frames_available:
                kept = latest.detail.model_copy(update={"frames_kept_until": utc_of_host(until_s)})
                self._cache(replace(latest, detail=kept))
            self._announced = finished.finish_number
            self._changed.notify_all()
        self._events.add("run", summary_line(finished.detail), state=finished.detail.state, run=finished.detail.id)

    def _number_of(self, run: str) -> int:
        """Return the finish number of a run; for a run that has not ended, that of the latest announced run."""
        try:
            return self.get(run).finish_number
        except StateError:
            return self._announced
        except GoneError:
            # A caller that was away for long goes on with the oldest run that is still kept.
            row = self._store.run(run)
            return (row.finish_number or 0) if row else 0

    def _cache(self, finished: FinishedRun) -> FinishedRun:
        self._recent[finished.detail.id] = finished
        self._recent.move_to_end(finished.detail.id)
        while len(self._recent) > CACHED_RUNS:
            self._recent.popitem(last=False)
        return finished

    def _parsed(self, row: RunRow) -> FinishedRun:
        calibration = Calibration.model_validate_json(self._store.document(row.calibration_digest))
        result, timeline = self._store.result(row.id), self._store.timeline(row.id)
        head = RecordingHead.model_validate_json(row.head) if row.head else None
        return FinishedRun(
            detail=_in_state(RunDetail.model_validate_json(row.detail), RunState(row.state)),
            finish_number=row.finish_number or 0,
            board_type=BoardType.model_validate_json(self._store.document(row.board_type_digest)),
            cameras=calibration.cameras(head.cameras) if head else (),
            stitch=without_components(Stitch.model_validate_json(result)) if result else None,
            document=result,
            timeline=Timeline.model_validate_json(timeline) if timeline else _EMPTY,
            head=head,
        )


_EMPTY = Timeline(frames_settled_s=(), tasks=(), last_frame_s=0.0, ready_s=None)


def summary_line(detail: RunDetail) -> str:
    """Return the message of the event that announces a finished run: its reasons and the time to the matrices."""
    message = "; ".join(reason.message for reason in detail.reasons) or "The matrices are available."
    ms = detail.timings.ready_after_last_frame_ms if detail.timings else None
    return message if ms is None else f"{message} {ms:.0f} ms after the last frame."


def _forgotten(run: str) -> GoneError:
    return GoneError(
        f"Result and record of run {run} were deleted because of their age, number or size.",
        action="Fetch results sooner, pin runs that are needed for long, or raise the limits of [keep].",
        code="run-forgotten",
    )


def _in_state(document: R, state: RunState) -> R:
    available = state in IN_MEMORY
    kept = {} if available else {"frames_kept_until": None}
    return document.model_copy(update={"state": state, "frames_available": available, **kept})


def _row(progress: Progress, detail: RunDetail, finish_number: int | None) -> RunRow:
    return RunRow(
        id=detail.id,
        state=detail.state,
        finish_number=finish_number,
        board_type_digest=progress.order.board_type_digest,
        calibration_digest=progress.order.calibration_digest,
        summary=summary_of(detail).model_dump_json(),
        detail=detail.model_dump_json(),
        head=progress.head.model_dump_json() if progress.head else None,
    )

"""Finished runs, for any thread: the latest in memory, all of them in the store, and waiting for the next."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

from vaoi_station.errors import DeviceError, NotFoundError, StateError
from vaoi_station.files.results import without_components
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Calibration, RecordingHead, Stitch
from vaoi_station.rendering import ViewCalculator
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import detail_of, summary_of, timeline_of
from vaoi_station.runs.states.schemas import Reason, RunDetail, RunSummary, Timeline
from vaoi_station.runs.states.tables import IN_MEMORY, RUN, RunState, RunStep
from vaoi_station.store import RunRow, Store

R = TypeVar("R", RunSummary, RunDetail)
REMEMBERED = 32
"""Finished runs whose documents stay parsed."""


@dataclass(frozen=True)
class Dossier:
    """All there is to know of a run that has ended."""

    detail: RunDetail
    finish_number: int
    board_type: BoardType
    cameras: tuple[Camera, ...]
    without_components: Stitch | None
    """The result less its tables of components."""
    document: str | None
    """The result as JSON text."""
    timeline: Timeline
    head: RecordingHead | None
    """What was filmed; None if the station ended meanwhile."""

    @cached_property
    def view_calculator(self) -> ViewCalculator:
        """Which frames show which component; `StateError` without a CAD mapping, `NotFoundError` without a result."""
        return ViewCalculator(self.board_type, self.without_components or self.result, self.cameras)

    @cached_property
    def result(self) -> Stitch:
        """All of the result; `NotFoundError` if the run ended without one."""
        return Stitch.model_validate_json(self.text)

    @property
    def text(self) -> str:
        """The same as JSON text; `NotFoundError` with the reasons if the run ended without one."""
        if self.document is None:
            raise NotFoundError(
                f"Run {self.detail.id} ended without a result: "
                + "; ".join(reason.message for reason in self.detail.reasons),
                action="Its frames can be had as long as they are kept.",
                code="no-result",
            )
        return self.document


class Archive:
    """What became of the runs. A run is announced once its result is on disk."""

    def __init__(self, store: Store, events: EventLog) -> None:
        self._store = store
        self._events = events
        self._news = threading.Condition()
        self._recent: OrderedDict[str, Dossier] = OrderedDict()
        self._under_way: set[str] = set()
        last = store.last_finished()
        self._finished = last.finish_number or 0 if last else 0
        """Given out; the newest may not have been announced yet."""
        self._announced = self._finished
        self._closed = False
        self._take_over()

    def begin(self, progress: Progress) -> None:
        """A run has begun; should the station die, its trace remains."""
        with self._news:
            self._under_way.add(progress.run)
        self._store.save_run(_row(progress, detail_of(progress), None))

    def finish(self, progress: Progress) -> RunDetail:
        """A run has ended: keep it, then tell everybody who waits."""
        self._finished += 1
        detail, order = detail_of(progress), progress.order
        dossier = Dossier(
            detail,
            self._finished,
            order.board_type,
            order.setup.cameras,
            progress.without_components,
            progress.result.document if progress.result else None,
            timeline_of(progress),
            progress.head,
        )
        with self._news:
            self._under_way.discard(progress.run)
            self._remember(dossier)
        row = _row(progress, detail, self._finished)
        saved = self._store.save_run(row, dossier.timeline.model_dump_json(), dossier.document)
        saved.add_done_callback(lambda future: self._announce(dossier, future))
        return detail

    def calibration_of(self, dossier: Dossier) -> Calibration:
        """The calibration a run was stitched with."""
        return Calibration.model_validate_json(self._store.document(dossier.detail.calibration))

    def mark(self, run: str, step: RunStep) -> None:
        """A finished run's frames were released, or their memory was taken."""
        dossier = self.get(run)
        state = RUN.next(dossier.detail.state, step)
        with self._news:
            self._remember(replace(dossier, detail=_in_state(dossier.detail, state)))
        self._store.set_state(run, state)

    def get(self, run: str) -> Dossier:
        """A finished run; `NotFoundError` if there was none of that id, `StateError` if it has not ended."""
        known = self._remembered(run)
        if known is not None:
            return known
        row = self._store.run(run)
        if row is None:
            raise NotFoundError(f"There is no run {run!r}.", action="See the list of runs.", code="unknown-run")
        if row.finish_number is None:
            if (known := self._remembered(run)) is not None:  # it has come to its end meanwhile
                return known
            raise DeviceError(f"The end of run {run} could not be written.", action="Check space on the data disk.")
        dossier = self._parsed(row)
        with self._news:
            return self._recent.get(run) or self._remember(dossier)

    def _remembered(self, run: str) -> Dossier | None:
        """A run of this life of the station; `StateError` if it has not ended."""
        with self._news:
            if run in self._under_way:
                raise StateError(f"Run {run} has no result yet.", action="Wait for it by runs/next.")
            return self._recent.get(run)

    def latest(self) -> Dossier | None:
        """The run that was announced last."""
        with self._news:
            announced = [d for d in self._recent.values() if d.finish_number == self._announced]
        if announced:
            return announced[0]
        row = self._store.last_finished()
        return None if row is None else self.get(row.id)

    def next(self, after: str | None, timeout_s: float) -> Dossier | None:
        """The run announced next after `after` (None: after now); None on time-out."""
        number = self._announced if after is None else self._number_of(after)
        deadline = time.monotonic() + timeout_s
        with self._news:
            while self._announced <= number and not self._closed:
                if not self._news.wait(deadline - time.monotonic()) and time.monotonic() >= deadline:
                    return None
            if self._announced <= number:
                return None
            kept = [d for d in self._recent.values() if d.finish_number == number + 1]
        if kept:
            return kept[0]
        row = self._store.finished_after(number)
        return None if row is None else self.get(row.id)

    def list(self, limit: int, before: str | None) -> list[RunSummary]:
        """Runs that have begun, newest first."""
        return [
            _in_state(RunSummary.model_validate_json(row.summary), RunState(row.state))
            for row in self._store.runs(limit, before)
        ]

    def close(self) -> None:
        """Wake everybody who waits; no more runs will end."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    def _take_over(self) -> None:
        """Runs of the station's earlier life: frames are gone; what was under way has failed, and says so."""
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

    def _announce(self, dossier: Dossier, saved: Future[None]) -> None:
        """Runs are announced in the order they ended, for they are written in that order."""
        fault = saved.exception()
        if fault is not None:
            self._events.add(
                "trouble", f"Run {dossier.detail.id} could not be written: {fault}", run=dossier.detail.id, code="store"
            )
        with self._news:
            self._announced = dossier.finish_number
            self._news.notify_all()
        self._events.add("run", summary_line(dossier.detail), state=dossier.detail.state, run=dossier.detail.id)

    def _number_of(self, run: str) -> int:
        """Where a run stands in the order of ends; one that has not ended stands at the end."""
        try:
            return self.get(run).finish_number
        except StateError:
            return self._announced

    def _remember(self, dossier: Dossier) -> Dossier:
        self._recent[dossier.detail.id] = dossier
        self._recent.move_to_end(dossier.detail.id)
        while len(self._recent) > REMEMBERED:
            self._recent.popitem(last=False)
        return dossier

    def _parsed(self, row: RunRow) -> Dossier:
        calibration = Calibration.model_validate_json(self._store.document(row.calibration_digest))
        result, timeline = self._store.result(row.id), self._store.timeline(row.id)
        head = RecordingHead.model_validate_json(row.head) if row.head else None
        return Dossier(
            detail=_in_state(RunDetail.model_validate_json(row.detail), RunState(row.state)),
            finish_number=row.finish_number or 0,
            board_type=BoardType.model_validate_json(self._store.document(row.board_type_digest)),
            cameras=calibration.cameras(head.cameras) if head else (),
            without_components=without_components(Stitch.model_validate_json(result)) if result else None,
            document=result,
            timeline=Timeline.model_validate_json(timeline) if timeline else _EMPTY,
            head=head,
        )


_EMPTY = Timeline(frames_settled_s=(), tasks=(), last_frame_s=0.0, ready_s=None)


def summary_line(detail: RunDetail) -> str:
    """What the log says of a run that has ended."""
    words = "; ".join(reason.message for reason in detail.reasons) or "The matrices are there."
    ms = detail.timings.ready_after_last_frame_ms if detail.timings else None
    return words if ms is None else f"{words} {ms:.0f} ms after the last frame."


def _in_state(shape: R, state: RunState) -> R:
    return shape.model_copy(update={"state": state, "frames_available": state in IN_MEMORY})


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

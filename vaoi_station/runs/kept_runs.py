"""What is kept of runs, as callers see it: pins, decisions, the search, and what follows the end of a run."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Literal, TypeVar

from pydantic import ValidationError

from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, NotFoundError, StateError, VaoiError
from vaoi_station.model import Status
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.archive.measured_heights import MeasuredHeights
from vaoi_station.runs.archive.measured_parts import MeasuredParts
from vaoi_station.runs.archive.read_identities import ReadIdentities
from vaoi_station.runs.archive.recordings import DIRECTORY, Recordings
from vaoi_station.runs.mosaics.kept_mosaics import KeptMosaics
from vaoi_station.runs.run.memory import FrameSource
from vaoi_station.runs.states.run_ids import earliest_id, utc
from vaoi_station.runs.states.schemas import (
    ArchiveStatus,
    Choice,
    Decision,
    RunCounts,
    RunDetail,
    RunSummary,
    StationSnapshot,
)
from vaoi_station.runs.states.tables import RunState
from vaoi_station.runs.trends.trends import TrendHistory
from vaoi_station.runs.workers.jobs import PictureJob
from vaoi_station.store.run_search import NO_VERDICT, RunFilter

R = TypeVar("R", bound=RunSummary)
_log = logging.getLogger(__name__)


class KeptRuns:
    """Pins and unpins runs, and completes their documents. Its methods may be called from any thread."""

    def __init__(
        self,
        config: StationConfig,
        archive: Archive,
        events: EventLog,
        frames: FrameSource,
        heights: MeasuredHeights,
        parts: MeasuredParts,
        mosaics: KeptMosaics,
        render: Callable[[PictureJob, str], Any],
    ) -> None:
        """Store the parts. `frames` are those in the ring; `render` has a worker perform a job for callers."""
        self._archive, self._events, self._after_run = archive, events, config.heights == "after-run"
        self.recordings = Recordings(config.data / DIRECTORY, config.keep, archive, events, frames)
        self.recordings.program = config.program
        self.archive_status: Callable[[], ArchiveStatus | None] = lambda: None
        """Function that returns the state of the archive to which runs are handed."""
        self.on_identified: Callable[[str, IdentityDocument], None] = lambda _run, _found: None
        """Function that is called with a run whose codes were read. It must return at once."""
        self.heights, self.parts, self.mosaics = heights, parts, mosaics
        self.identities = ReadIdentities(archive, render, frames.bay_of, events)
        self.history = RunHistory(archive, events)
        names = [camera.name for camera in config.cameras]
        self.trends = TrendHistory(archive.figures, names, config.keep.database_gb)
        archive.on_finished, archive.on_explained = self._finished, self.recordings.update
        self.identities.on_changed = self._identity_changed

    def start(self) -> None:
        """Start the threads that write recordings, and have codes read, heights and parts measured."""
        self.recordings.start()
        self.identities.start()
        self.heights.queue.start()
        self.parts.queue.start()
        self.mosaics.queue.start()

    def stop(self) -> None:
        """End these threads."""
        self.mosaics.queue.stop()
        self.parts.queue.stop()
        self.heights.queue.stop()
        self.identities.queue.stop()
        self.recordings.stop()

    def tend(self) -> None:
        """Delete recordings and pictures that are not to be kept any more."""
        self.recordings.tend()
        self.mosaics.tend()

    def _finished(self, detail: RunDetail) -> None:
        """Keep what is to be kept of a run that has just ended; it returns at once.

        An error in one part prevents neither the others nor the announcement of the run.
        """
        parts: dict[str, Callable[[RunDetail], object]] = {
            "trends": lambda run: self.trends.finished(run, lambda name: self._archive.get(name).stitch),
            # Before the recording, which states whether the identity of its run is decided.
            "identity": self.identities.finished,
            "recording": self.recordings.finished,
            "picture of the board": self.mosaics.finished,
            "measures of parts": self.parts.finished,
        }
        if self._after_run:
            parts["heights"] = lambda run: self.heights.queue.put(run.id)
        for name, finish in parts.items():
            try:
                finish(detail)
            except Exception as fault:  # noqa: BLE001  callers wait for the run, whatever follows it
                _log.exception("run %s: %s", detail.id, name)
                self._events.add(
                    "trouble",
                    f"The {name} of the run cannot be kept ({type(fault).__name__}: {fault}).",
                    run=detail.id, code="not-kept", action="Report it to the maintainer, if it returns.",
                )  # fmt: skip

    def _identity_changed(self, run: str) -> None:
        """Keep a run that its identity degrades as others that are not ok, and renew its record; it returns at once."""
        with suppress(VaoiError):  # The run was forgotten.
            finished = self._archive.get(run)
            detail = finished.detail
            if finished.identity is not None:
                self.on_identified(run, finished.identity)
            if detail.verdict is not Status.OK and detail.frames_available:
                self.recordings.finished(detail)
        self.recordings.update(run)

    def pin(self, run: str) -> None:
        """Keep a run until it is unpinned: its record and result, and its frames if they are in memory.

        Raises the errors of `Archive.get`, except for a run that has not ended, and StateError: too many are pinned.
        """
        try:
            finished = self._archive.get(run)
        except StateError:
            finished = None  # The run is being filmed or stitched: its frames are kept when it has ended.
        if not self._archive.retention.pinned(run):
            self._archive.retention.pin(run, utc())
            self._events.add("run", "The run was pinned.", run=run)
        if finished is not None and finished.detail.frames_available:
            self.recordings.request(run)

    def unpin(self, run: str) -> None:
        """Remove the pin of a run; `NotFoundError` if it has none. The limits of `[keep]` apply to the run again."""
        if not self._archive.retention.pinned(run):
            raise NotFoundError(f"Run {run!r} is not pinned.", action="See the list of runs.", code="not-pinned")
        self._archive.retention.unpin(run)
        self._events.add("run", "The run was unpinned.", run=run)

    def shown(self, document: R, figures: bool = False) -> R:
        """Return the document of a run as `all_shown` does."""
        return self.all_shown((document,), figures)[0]

    def all_shown(self, documents: tuple[R, ...], figures: bool = False) -> tuple[R, ...]:
        """Return documents of runs with `pinned`, `recording`, `decision`, and `figures` if asked for."""
        pins, decisions = self._archive.retention.pins(), self.history.decisions(documents)
        known = self.trends.figures([document.id for document in documents]) if figures else {}

        def filled(run: str) -> dict[str, Any]:
            return {
                "pinned": run in pins,
                "recording": self.recordings.path_of(run) is not None,
                "decision": decisions.get(run),
                "figures": known.get(run),
            }

        return tuple(document.model_copy(update=filled(document.id)) for document in documents)

    def with_id(
        self, board_id: str, wanted: RunFilter, limit: int, before: str | None
    ) -> tuple[tuple[RunSummary, ...], str | None]:
        """Return summaries of runs of which an id was read or reported, newest first, and the cursor of the next page.

        At most `limit` runs are checked against the filter.
        """
        runs = self._archive.identities.runs_of(board_id, limit + 1, before)
        found = self._archive.summaries(runs[:limit])
        admitted = tuple(found[run] for run in runs[:limit] if run in found and RunHistory.admits(wanted, found[run]))
        return admitted, runs[limit - 1] if len(runs) > limit else None

    def with_counts(self, snapshot: StationSnapshot) -> StationSnapshot:
        """Return the snapshot with the numbers of recordings and kept pictures filled in."""
        recordings, mosaics = self.recordings, self.mosaics
        counts = {
            "recordings": recordings.runs,
            "recordings_bytes": recordings.size_bytes,
            "recordings_late": recordings.counts.late,
            "recordings_refused": recordings.counts.refused,
            "mosaics": mosaics.runs,
            "mosaics_bytes": mosaics.size_bytes,
            "archive": self.archive_status(),
        }
        return snapshot.model_copy(update={"retention": snapshot.retention.model_copy(update=counts)})


Wanted = Literal["ok", "degraded", "failed", "none"]
"""A verdict, or `none`: the run ended without a result."""
_CHOICES: dict[Choice, str] = {"film-again": "The board is to be filmed again", "use": "Its pictures are used"}


class RunHistory:
    """Searches, counts and decides. Its methods may be called from any thread."""

    def __init__(self, archive: Archive, events: EventLog) -> None:
        self._archive, self._events = archive, events

    def find(self, wanted: RunFilter, limit: int, before: str | None) -> tuple[list[RunSummary], str | None]:
        """Return at most `limit` runs that a filter admits, newest first, and where the search goes on (None: nowhere).

        One call reads a bounded number of runs, so it may find fewer than `limit` although there are more.
        """
        oldest = self._oldest(wanted.since)
        # Runs that the disk has not taken yet are in memory; the database has them as they began. They are read first:
        # one that is written meanwhile is in at least one of the two.
        waiting = self._archive.unstored()
        found = self._archive.search.find(wanted, limit, before, oldest, [run.id for run in waiting])
        runs = self._archive.summaries(found.runs)
        for summary in waiting:
            here = (before is None or summary.id < before) and (found.before is None or summary.id >= found.before)
            if here and self.admits(wanted, summary):
                runs[summary.id] = summary
        chosen = sorted(runs, reverse=True)[:limit]
        more = chosen[-1] if len(chosen) == limit else found.before
        return [runs[run] for run in chosen], more

    def counts(self, since: datetime) -> RunCounts:
        """Return how many boards have passed since a time, by verdict, and how many were missed."""
        moment = utc(since.astimezone(UTC))
        waiting = self._archive.unstored()
        found = self._archive.search.verdicts(moment, self._oldest(moment), [run.id for run in waiting])
        stored = dict(found.runs)
        for summary in (s for s in waiting if s.started >= moment):
            verdict = summary.verdict or NO_VERDICT
            stored[verdict] = stored.get(verdict, 0) + 1
        return RunCounts(
            since=moment,
            ok=stored.get("ok", 0),
            degraded=stored.get("degraded", 0),
            failed=stored.get("failed", 0) + stored.get(NO_VERDICT, 0),
            missed=self._archive.search.count_events("board-missed", moment),
            complete=found.complete,
        )

    def decide(self, run: str, choice: Choice, name: str, reason: str) -> None:
        """Keep what a person has decided about a run; a later decision replaces it.

        Raises:
            NotFoundError: the run is unknown.
            StateError: the run has not ended, or is not on disk yet.
        """
        self._archive.get(run)
        decision = Decision(choice=choice, name=name, reason=reason, decided=utc())
        if not self._archive.store.save_decision(run, decision.model_dump_json()):
            raise StateError(
                f"Run {run} is not on disk yet, so that no decision about it can be kept.",
                action="Repeat this once the data disk takes writes again.",
                code="not-stored",
            )
        self._events.add("decision", f"{_CHOICES[choice]}, decided by {name}: {reason}", run=run, state=choice)

    def decisions(self, runs: tuple[RunSummary, ...]) -> dict[str, Decision]:
        """Return the decisions about some runs, by run id."""
        found: dict[str, Decision] = {}
        with suppress(DeviceError):  # The latest runs are in memory, and shown even if the disk cannot be read.
            for run, document in self._archive.store.decisions([run.id for run in runs]).items():
                with suppress(ValidationError):  # of another version: the run is shown without it
                    found[run] = Decision.model_validate_json(document)
        return found

    def _oldest(self, since: str | None) -> str:
        if since is None:
            return ""
        return self._archive.search.oldest_since(earliest_id(datetime.fromisoformat(since).timestamp()))

    @staticmethod
    def admits(wanted: RunFilter, run: RunSummary) -> bool:
        """Return whether a filter admits a run."""
        codes = [code for reason in run.reasons for code in (reason.code, reason.cause)]
        ended = run.state not in (RunState.FILMING, RunState.STITCHING)
        verdict = run.verdict or (NO_VERDICT if ended else None)
        return wanted.admits(verdict, run.board_type, run.board_id, codes, run.started)

"""Hands kept recordings to an archive: one process of the lowest priority, which waits while a board is under way.

Runs wait for the archive as recordings on the station's disk, within `keep.recordings_gb`: an archive that is full or
absent costs the oldest of them, and never a board.
"""

from __future__ import annotations

import logging
import subprocess
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import ArchiveConfig
from vaoi_station.errors import DeviceError, StateError, VaoiError
from vaoi_station.model import Reason, Status
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.housekeeping import TASK_LIMIT_S
from vaoi_station.runs.archive.recordings import Recordings
from vaoi_station.runs.handover.adder import Added, Addition, Failed, Turn, launch_adder
from vaoi_station.runs.states.schemas import ArchiveStatus, RunSummary
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

RETRY = BackoffPolicy(first_s=10.0, longest_s=300.0, proven_s=60.0)
"""Pauses between attempts to reach an archive that is full or absent."""
LINE_PAUSE_S = 0.2
"""Period of the check whether the board has left."""
SILENCE_S = 300.0
"""Longest silence of the adder while no board is filmed or stitched: a share whose server is down blocks for ever."""
END_S = 5.0
"""Longest wait for the end of the adder: one that is blocked by a share ends only when the share answers."""


class Handover:
    """Adds every kept recording to an archive, and of the good runs every n-th."""

    def __init__(self, config: ArchiveConfig, station: str, events: EventLog, busy: Callable[[], bool]) -> None:
        """Prepare. `busy` returns whether a board is being filmed or stitched."""
        self._config, self._station, self._events, self._busy = config, station, events, busy
        self._backoff = Backoff(RETRY)
        self._adder: tuple[Connection[Any, Any], subprocess.Popen[bytes]] | None = None
        self._ended: subprocess.Popen[bytes] | None = None
        """The last adder that was ended. While it is blocked no other is started: each would be blocked as well."""
        self._changed = threading.Condition()
        self._waiting: dict[str, int] = {}
        """Runs that are to be added, in the order in which they were kept, and how often each was offered."""
        self._present: str | None = None
        self._added = self._dropped = self._refused = 0
        self._problem: VaoiError | None = None
        self._stopping = threading.Event()
        self.thread = SupervisedThread(self._run, "archive", TASK_LIMIT_S)

    @contextmanager
    def running(self, recordings: Recordings) -> Iterator[None]:
        """Hand over the recordings of a station while a `with` block runs; first those of earlier runs."""
        self._recordings = recordings
        recordings.wanted_for_archive = self.wants
        recordings.on_kept = self.offer
        recordings.awaited = self._awaited
        recordings.offer_all()
        self.thread.start()
        try:
            yield
        finally:
            self._stop()

    def _stop(self) -> None:
        """End the thread. A run that is being added is given up; the next start goes on where it ended."""
        self.thread.expect_end()
        self._stopping.set()
        with self._changed:
            self._changed.notify_all()
        self.thread.join()

    def wants(self, run: RunSummary) -> bool:
        """Return whether a run is to be recorded for the archive if it is not kept otherwise."""
        if run.verdict is not Status.OK:
            return True
        every = self._config.ok_every
        # By the id, not by a counter: a restart does not change which runs are chosen.
        return bool(every) and zlib.crc32(run.id.encode()) % every == 0

    def offer(self, run: str) -> None:
        """Add the recording of a run when there is time for it; again if it has changed meanwhile. Returns at once."""
        with self._changed:
            self._waiting[run] = self._waiting.get(run, 0) + 1
            self._changed.notify_all()

    def _awaited(self) -> tuple[str, ...]:
        with self._changed:
            return tuple(self._waiting)

    def status(self) -> ArchiveStatus:
        """Return what was added and what waits."""
        problem = self._problem
        return ArchiveStatus(
            url=self._config.url,
            waiting=len(self._waiting),
            adding=self._present,
            added=self._added,
            dropped=self._dropped,
            refused=self._refused,
            problem=problem.message if problem else "",
        )

    def reasons(self) -> tuple[Reason, ...]:
        """Return a warning while the archive takes no runs."""
        problem = self._problem
        if problem is None:
            return ()
        message = (
            f"The archive takes no runs: {problem.message} {len(self._waiting)} runs wait on this disk; the oldest are "
            "deleted when recordings exceed [keep] recordings_gb."
        )
        action = problem.action or "Free space in the archive, or correct [archive] of station.toml."
        return (Reason(code="archive-waits", message=message, action=action),)

    def _run(self) -> None:
        try:
            while (run := self._next()) is not None:
                self._present = run
                try:
                    self._add(run)
                except StateError:
                    return  # The station is stopping.
                finally:
                    self._present = None
        finally:
            self._end_adder()

    def _next(self) -> str | None:
        """Wait for a run, and for the end of a pause after a failure; None is the request to end."""
        with self.thread.waiting(), self._changed:
            while not self._stopping.is_set():
                pause_s = self._backoff.remaining_s()
                if self._waiting and not pause_s:
                    return next(iter(self._waiting))
                self._changed.wait(pause_s or None)
            return None

    def _add(self, run: str) -> None:
        folder = self._recordings.path_of(run)
        if folder is None:
            self._drop(run)
            return
        with self._changed:
            offers = self._waiting[run]
        outcome = self._outcome(Addition(self._config.url, folder, self._station))
        if isinstance(outcome, Added):
            _log.info("run %s is in the archive %s, %d bytes", run, self._config.url, outcome.bytes)
            if self._done(run, offers):
                self._added += 1
                try:
                    self._recordings.release(run)
                except (VaoiError, OSError) as error:  # It is released after the next start.
                    _log.warning("the recording of run %s, which the archive has, stays: %s", run, error)
            self._reached()
        elif self._recordings.path_of(run) is None:
            self._drop(run)  # Its recording was deleted meanwhile, to make room for a later one.
        elif outcome.of_run:
            if self._done(run, offers):
                self._refused += 1
                message, action = f"The run was not archived: {outcome.error.message}", outcome.error.action
                self._events.add("trouble", message, run=run, code="archive-refused", action=action)
            self._reached()
        else:
            self._failed(outcome.error)

    def _outcome(self, wanted: Addition) -> Added | Failed:
        """Have the adder add a run; StateError if the station stops meanwhile."""
        if self._ended is not None and self._ended.poll() is None:
            return Failed(self._silent(), of_run=False)
        try:
            if self._adder is None:
                self._adder = launch_adder()
            pipe = self._adder[0]
            pipe.send(wanted)
            while isinstance(reply := self._reply(pipe), Turn):
                self._wait_for_turn(reply.size)
                pipe.send(True)
            return reply
        except StateError:
            raise
        except Exception as error:  # noqa: BLE001  whatever ends the adder or its start must not end the station
            self._end_adder()
            if isinstance(error, DeviceError):
                return Failed(error, of_run=False)
            cause = f"{type(error).__name__}: {error}".rstrip(": ")  # EOFError has no text
            message = f"The process that adds runs does not run ({cause})."
            return Failed(DeviceError(message, action="See the log; it is started again."), of_run=False)

    def _reply(self, pipe: Connection[Any, Any]) -> Turn | Added | Failed:
        """Wait for the adder; DeviceError if it is silent for too long."""
        silent_s = 0.0
        while not pipe.poll(LINE_PAUSE_S):
            self._go_on()
            # A board takes the processor from the adder, which has the lowest priority.
            silent_s += 0.0 if self._busy() else LINE_PAUSE_S
            if silent_s >= SILENCE_S:
                raise self._silent()
        reply: Turn | Added | Failed = pipe.recv()
        return reply

    def _silent(self) -> DeviceError:
        return DeviceError(
            f"{self._config.url}: does not answer for more than {SILENCE_S:g} s.",
            action="Check the server and the connection of the share.",
            code="archive-absent",
        )

    def _wait_for_turn(self, size: int) -> None:
        """Wait until no board is filmed or stitched, and the time of `size` bytes."""
        self._go_on()
        while self._busy():
            self._stopping.wait(LINE_PAUSE_S)
            self._go_on()
        end_s = time.monotonic() + (size / (1e6 * self._config.mb_s) if self._config.mb_s else 0.0)
        while (left_s := end_s - time.monotonic()) > 0:
            self._stopping.wait(min(left_s, LINE_PAUSE_S))
            self._go_on()

    def _go_on(self) -> None:
        """Record that the thread is alive; StateError if it is to end."""
        self.thread.beat()
        if self._stopping.is_set():
            raise StateError("The station is stopping.")

    def _end_adder(self) -> None:
        """End the process; what it has written stays, and is found by the next addition."""
        if self._adder is not None:
            pipe, process = self._adder
            self._adder = None
            pipe.close()
            process.kill()
            with suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            self._ended = process

    def _reached(self) -> None:
        """Record that the archive takes runs."""
        self._backoff.reset()
        if self._problem is not None:
            self._problem = None
            self._events.add("storage", f"The archive {self._config.url} takes runs again.", code="archive-back")

    def _failed(self, error: VaoiError) -> None:
        """Try again after a pause; publish the problem when it begins."""
        self._backoff.record_failure()
        _log.warning("archive: %s", error)
        began, self._problem = self._problem is None, error
        if began:
            [reason] = self.reasons()
            self._events.add("trouble", reason.message, code=reason.code, action=reason.action)

    def _done(self, run: str, offers: int) -> bool:
        """Remove a run from those that wait, unless it was offered again since; return whether it was removed."""
        with self._changed:
            if self._waiting[run] != offers:
                return False
            del self._waiting[run]
            return True

    def _drop(self, run: str) -> None:
        with self._changed:
            del self._waiting[run]
        self._dropped += 1
        message = "The run was not archived: its recording was deleted for later ones before the archive took it."
        action = "Restore the archive, or raise [keep] recordings_gb."
        self._events.add("trouble", message, run=run, code="archive-dropped", action=action)

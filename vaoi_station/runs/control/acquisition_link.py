"""The link to the acquisition process. It starts the process, passes messages, and restarts it if it ends or hangs."""

from __future__ import annotations

import atexit
import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

from vaoi_station.acquisition.process.messages import Command, Ready, Report, Shutdown, Trouble
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import StationConfig
from vaoi_station.runs.host.message_pipe import MessagePipe, PipeEndedError, wait_for
from vaoi_station.runs.host.processes import acquire
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import STARTING, WAITING, ProcessStatus
from vaoi_station.supervised_thread import SupervisedThread

HEARTBEAT_LIMIT_S = 10.0
"""Longest silence of the running process, which sends two heartbeats per second. After it, the process is killed."""
START_LIMIT_S = 60.0
"""Longest silence of a process before its first message: opening cameras, or rendering a scenario, takes time."""
WARM_POLL_S = 0.1
"""Time between two checks whether the workers are ready, s."""
EXIT_S = 2.0
"""Longest time from the end of the pipe to the end of the process. After it, the process is killed."""
PACE = BackoffPolicy(first_s=0.5, longest_s=60.0, proven_s=30.0)
"""Pauses between restarts of the acquisition process."""
PLUGGED_S = 6.0
"""Longest pause between restarts while a device is absent or in use, so that it is used soon after it is plugged in."""
_ABSENT = frozenset(
    {
        "camera-absent", "camera-in-use", "camera-lost", "port-absent", "port-in-use", "port-forbidden",
        "controller-silent",
    }
)  # fmt: skip
"""Codes of troubles that end when a device is plugged in or switched on, or when another program releases it. After
others (refused settings, wrong input, a crash), earlier retries would not help."""


class Process(Protocol):
    """The part of `multiprocessing.Process` that is used; tests replace it by a scripted process."""

    @property
    def pid(self) -> int | None:
        """The id of the acquisition process."""

    @property
    def sentinel(self) -> int:
        """The file descriptor that is readable when the process has ended."""

    @property
    def exitcode(self) -> int | None:
        """Exit code of the process; None while it runs."""

    def kill(self) -> None:
        """Kill the acquisition process at once."""

    def join(self, timeout: float | None = None) -> None:
        """Wait until the process has ended, or `timeout` seconds have passed."""

    def close(self) -> None:
        """Release the resources that this Python process holds for the ended process."""


Launch = Callable[[], tuple[Process, "Connection[Any, Any]"]]
"""Function that starts an acquisition process, and returns it with the station's end of the pipe to it."""


def spawn_launcher(config: Callable[[], StationConfig], ring: Path) -> Launch:
    """Return a function that starts the real acquisition process, with the configuration of that moment."""

    def launch() -> tuple[Process, Connection[Any, Any]]:
        # "spawn": a forked child would inherit the station's threads' locks in an unknown state.
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        process = spawn.Process(target=acquire, args=(config(), str(ring), there), name="vaoi-acquisition", daemon=True)
        process.start()
        there.close()
        return process, here

    return launch


@dataclass
class _Attempt:
    process: Process
    pipe: MessagePipe
    last_message_s: float
    has_reported: bool = False
    ready: bool = False
    cause: str = ""
    """Code of the last trouble reported before the process was ready."""

    @property
    def silence_s(self) -> float:
        return time.monotonic() - self.last_message_s

    def record(self, report: Report) -> None:
        self.last_message_s, self.has_reported = time.monotonic(), True
        if isinstance(report, Ready):
            self.ready = True
        elif isinstance(report, Trouble) and not self.ready:
            self.cause = report.code


class AcquisitionLink:
    """Starts and restarts the acquisition process, and reports its messages and its ends, in a thread of its own."""

    def __init__(self, launch: Launch, backoff: Backoff | None = None) -> None:
        """Prepare a link. `backoff` has the pauses between restarts; None: those of `PACE`."""
        self._launch, self._backoff = launch, backoff or Backoff(PACE)
        self._lock = threading.Lock()
        self._attempt: _Attempt | None = None
        self._warmed = self._holds = False
        self._restarts = 0
        self._stopping = threading.Event()
        self.thread = SupervisedThread(self._run, "acquisition-link")

    def start(
        self,
        on_message: Callable[[Report], object],
        on_end: Callable[[str], object],
        warm: Callable[[], bool] = lambda: True,
    ) -> None:
        """Start the process. That it is ready is reported once `warm` returns True, that is, the workers are ready too.

        Until then, however long it takes, the state of the station is "starting", and it accepts no board. The devices
        are opened while the workers warm up. `on_end` gets a description of each end, after which it is restarted.
        """
        self._on_message, self._on_end, self._warm = on_message, on_end, warm
        # The process ignores SIGTERM (`set_up_process`), which is all that multiprocessing's exit handler sends before
        # it waits: without this call an interpreter that exits early would hang.
        atexit.register(self.stop, 0.0)
        self.thread.start()

    def send(self, command: Command) -> None:
        """Send a command to the process. If it has ended, the command is lost; `on_end` reports the end."""
        with self._lock:
            if self._attempt is not None:
                self._attempt.pipe.send(command)

    def status(self) -> ProcessStatus:
        """Return the state of the acquisition process, for `GET station` and the page."""
        with self._lock:
            attempt, due_s = self._attempt, self._backoff.due_s
            doing = STARTING if attempt is not None and not attempt.has_reported else ""
            if self._holds:
                doing = WAITING
            return ProcessStatus(
                name="acquisition",
                pid=attempt.process.pid if attempt else None,
                alive=attempt is not None and attempt.process.exitcode is None,
                restarts=self._restarts,
                heartbeat_age_s=attempt.silence_s if attempt else None,
                doing=doing,
                next_try=None if due_s is None else utc_of_host(due_s),
            )

    def stop(self, timeout_s: float = 5.0) -> None:
        """Let the process close its devices and end; kill it after `timeout_s`. A second call has no effect."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self.thread.expect_end()
        atexit.unregister(self.stop)
        self.send(Shutdown())
        if self.thread.ident is None:
            return
        self.thread.join(timeout_s)
        with self._lock:
            if self._attempt is not None:
                self._attempt.process.kill()
        self.thread.join(2 * EXIT_S)
        with self._lock:
            if self._attempt is not None and not self.thread.is_alive():  # a lost thread has not collected its process
                self._attempt.pipe.close()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                attempt = self._launch_process()
            except OSError as fault:
                # There is too little memory, or there are too many processes or files. This may pass.
                self._pause(PACE.longest_s, f"the acquisition process could not be started ({fault})")
                continue
            how = self._listen(attempt)
            code = self._collect(attempt)
            if self._stopping.is_set():
                return
            self._restarts += 1
            # A process that reported a trouble during its start and exited with code 0 did not crash.
            gave_up = attempt.cause and code == 0
            description = "the acquisition process could not start" if gave_up else f"{how} (code {code})"
            self._pause(PLUGGED_S if attempt.cause in _ABSENT else PACE.longest_s, description)

    def _pause(self, longest_s: float, description: str) -> None:
        """Report that the process has ended or was not started, and wait until the next attempt is due."""
        self._backoff.record_failure(longest_s)
        self._on_end(description)
        self.thread.rest()
        self._stopping.wait(self._backoff.remaining_s())
        self.thread.beat()

    def _launch_process(self) -> _Attempt:
        self._backoff.start_attempt()
        process, connection = self._launch()
        with self._lock:
            self._attempt = _Attempt(process, MessagePipe(connection), time.monotonic())
            # stop() may have run between the launch and this lock. It found no process then and sent no Shutdown.
            if self._stopping.is_set():
                self._attempt.pipe.send(Shutdown())
            return self._attempt

    def _listen(self, attempt: _Attempt) -> str:
        """Report the messages of the process until it ends or hangs, and return a phrase that describes its end."""
        # `Ready` and what follows it wait here for the workers.
        pending: deque[Report] = deque()
        how = self._listen_until_end(attempt, pending)
        # A process that has ended is not ready any more, but why it has ended concerns the operator.
        for report in pending:
            if isinstance(report, Trouble):
                self._on_message(report)
        return how

    def _listen_until_end(self, attempt: _Attempt, pending: deque[Report]) -> str:
        ended = "the acquisition process ended"
        while True:
            self.thread.beat()
            self._holds = bool(pending)
            ready = wait_for([attempt.pipe], [attempt.process.sentinel], WARM_POLL_S if pending else 0.5)
            attempt.pipe.flush()
            try:
                # The pipe is read before the sentinel is checked: the last messages of an ended process are delivered
                # too.
                reports = attempt.pipe.receive()
            except PipeEndedError:
                return ended
            for report in reports:
                attempt.record(report)
                # Every message proves that the process still runs. After success for `proven_s`, the next failure
                # counts as a first one again, with the shortest pause.
                if attempt.ready:
                    self._backoff.record_success()
            pending += reports
            while pending and (not isinstance(pending[0], Ready) or self._is_warm()):
                self._on_message(pending.popleft())
            if not reports and attempt.process.sentinel in ready:
                return ended
            limit_s = HEARTBEAT_LIMIT_S if attempt.has_reported else START_LIMIT_S
            if attempt.silence_s > limit_s and not self._stopping.is_set():  # `stop` has a limit of its own
                attempt.process.kill()
                return f"the acquisition process sent no heartbeat for {attempt.silence_s:.0f} s"

    def _is_warm(self) -> bool:
        # Only the first start waits: boards are filmed while workers are replaced.
        self._warmed = self._warmed or self._warm()
        return self._warmed

    def _collect(self, attempt: _Attempt) -> int | None:
        """Wait for the end of a process whose pipe has closed, at last kill it; return its exit code."""
        with self._lock:
            self._attempt, self._holds = None, False
        # It gets time to end by itself: a killed process does not return the exit code that shows whether it crashed.
        attempt.process.join(EXIT_S)
        if attempt.process.exitcode is None:
            attempt.process.kill()
            attempt.process.join(EXIT_S)
        # A killed process may still wait for a device in the kernel. It is left alone; the next process reports the
        # device as in use.
        if (code := attempt.process.exitcode) is not None:
            attempt.process.close()
        attempt.pipe.close()
        return code

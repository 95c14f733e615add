"""The acquisition process, seen from the station: started, listened to, started again when it dies or hangs."""

from __future__ import annotations

import atexit
import multiprocessing
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

from vaoi_station.acquisition.process.messages import Command, Ready, Report, Shutdown, Trouble
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import StationConfig
from vaoi_station.runs.control.station_events import StationEvents
from vaoi_station.runs.host.process_setup import set_up_process
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import STARTING, WAITING, ProcessStatus

SILENCE_S = 10.0
"""Without a sign of life for so long (it gives two a second) the process is taken for hung and killed."""
START_S = 60.0
"""The same before its first word: cameras take their time to open, scenarios to be rendered."""
WARM_S, LOOK_S = 60.0, 0.1
"""Workers have so long to warm up before boards are taken all the same, and whether they have is looked at so often."""
LAST_S = 2.0
"""Between the end of its pipe and its own."""
PACE = BackoffPolicy(first_s=0.5, longest_s=60.0, proven_s=30.0)
"""How soon it is started again."""
PLUGGED_S = 6.0
"""The longest pause while something is only absent: what is plugged in is taken soon. Settings that a camera refuses,
wrong input, or a process that dies by itself are not mended by hurry."""
_ABSENT = frozenset(
    {
        "camera-absent",
        "camera-in-use",
        "camera-lost",
        "port-absent",
        "port-in-use",
        "port-forbidden",
        "controller-silent",
    }
)


class Process(Protocol):
    """What the link needs of a process; `multiprocessing` has it."""

    @property
    def pid(self) -> int | None:
        """Its number."""

    @property
    def sentinel(self) -> int:
        """Becomes ready to read when it ends."""

    @property
    def exitcode(self) -> int | None:
        """None while it lives."""

    def kill(self) -> None:
        """End it at once."""

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended."""

    def close(self) -> None:
        """Give back what it held here."""


Launch = Callable[[], tuple[Process, "Connection[Any, Any]"]]


def spawned(config: StationConfig, ring: Path) -> Launch:
    """Starts the real acquisition process."""

    def launch() -> tuple[Process, Connection[Any, Any]]:
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        process = spawn.Process(target=acquire, args=(config, str(ring), there), name="vaoi-acquisition", daemon=True)
        process.start()
        there.close()
        return process, here

    return launch


def acquire(config: StationConfig, ring: str, connection: Connection[Any, Any]) -> None:
    """The acquisition process."""
    set_up_process(one_thread=False)
    from vaoi_station.acquisition.process.main_loop import run_acquisition

    run_acquisition(config, Path(ring), connection)


@dataclass
class _Life:
    """One process from start to end."""

    process: Process
    connection: Connection[Any, Any]
    heard_s: float
    spoke: bool = False
    ready: bool = False
    cause: str = ""
    """Code of the last trouble it told before it was ready."""

    def note(self, report: Report) -> None:
        """It has said something."""
        self.heard_s, self.spoke = time.monotonic(), True
        if isinstance(report, Ready):
            self.ready = True
        elif isinstance(report, Trouble) and not self.ready:
            self.cause = report.code

    def ending(self, how: str, code: int | None) -> str:
        """How it ended; who said before why it cannot begin need not be accused of anything."""
        return "the acquisition process could not begin" if self.cause and code == 0 else f"{how} (code {code})"


def longest_s(cause: str) -> float:
    """The longest pause after a life that ended for this reason (the code of its last trouble; empty: none told)."""
    return PLUGGED_S if cause in _ABSENT else PACE.longest_s


class AcquisitionLink:
    """Reports messages and ends of the process as events, in the link's own thread."""

    def __init__(self, launch: Launch) -> None:
        self._launch = launch
        self._events: StationEvents | None = None
        self._warm: Callable[[], bool] = lambda: True
        self._lock = threading.Lock()
        self._life: _Life | None = None
        self._begun = False
        self._restarts = 0
        self._backoff = Backoff(PACE)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="acquisition-link", daemon=True)

    def start(self, events: StationEvents, warm: Callable[[], bool] = lambda: True) -> None:
        """Start the process once the workers are `warm`, or take too long, and report its messages to `events`."""
        self._events, self._warm = events, warm
        atexit.register(self.stop, 0.0)  # the process leaves SIGTERM to the station: nobody else would end it
        self._thread.start()

    def send(self, command: Command) -> None:
        """Tell the process something; if it has just died, its death is reported instead."""
        with self._lock:
            if self._life is not None:
                _send(self._life.connection, command)

    def status(self) -> ProcessStatus:
        """How the process does."""
        with self._lock:
            life = self._life
            return ProcessStatus(
                name="acquisition",
                pid=life.process.pid if life else None,
                alive=life is not None and life.process.exitcode is None,
                restarts=self._restarts,
                heartbeat_age_s=time.monotonic() - life.heard_s if life else None,
                doing=self._doing(),
                next_try=None if (due_s := self._backoff.due_s) is None else utc_of_host(due_s),
            )

    def _doing(self) -> str:
        if self._life is not None:
            return "" if self._life.spoke else STARTING
        return "" if self._begun or self._stopping.is_set() else WAITING

    def stop(self, timeout_s: float = 5.0) -> None:
        """Have the cameras closed and the process ended; harmless when stopped."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        atexit.unregister(self.stop)
        self.send(Shutdown())
        if self._thread.ident is None:
            return
        self._thread.join(timeout_s)
        with self._lock:
            life = self._life
            if life is not None:
                life.process.kill()
        self._thread.join()

    def _run(self) -> None:
        assert self._events is not None, "start() sets it before it starts the thread"
        until_s = time.monotonic() + WARM_S
        while not self._warm() and time.monotonic() < until_s and not self._stopping.wait(LOOK_S):
            continue
        while not self._stopping.is_set():
            life = self._begin()
            sentence = self._listen(life, self._events)
            with self._lock:
                self._life = None
            life.process.join(LAST_S)
            if life.process.exitcode is None:
                life.process.kill()
                life.process.join()
            code = life.process.exitcode
            life.process.close()
            life.connection.close()
            if self._stopping.is_set():
                return
            self._restarts += 1
            self._backoff.record_failure(longest_s(life.cause))
            self._events.acquisition_ended(life.ending(sentence, code))
            self._stopping.wait(self._backoff.remaining_s())

    def _begin(self) -> _Life:
        self._backoff.start_attempt()
        process, connection = self._launch()
        with self._lock:
            self._life, self._begun = _Life(process, connection, time.monotonic()), True
            if self._stopping.is_set():
                _send(connection, Shutdown())
            return self._life

    def _listen(self, life: _Life, events: StationEvents) -> str:
        """Pass reports on until the process ends; how it ended."""
        while True:
            ready = wait([life.connection, life.process.sentinel], timeout=0.5)
            if life.connection in ready:
                try:
                    report = life.connection.recv()
                except (EOFError, ConnectionResetError):
                    return "the acquisition process ended"
                life.note(report)
                if life.ready:
                    self._backoff.record_success()
                events.acquisition_message(report)
            elif life.process.sentinel in ready:
                return "the acquisition process ended"
            elif time.monotonic() - life.heard_s > (SILENCE_S if life.spoke else START_S):
                life.process.kill()
                return f"the acquisition process gave no sign of life for {time.monotonic() - life.heard_s:.0f} s"


def _send(connection: Connection[Any, Any], command: Command) -> None:
    try:
        connection.send(command)
    except (BrokenPipeError, ConnectionResetError, OSError):
        return  # the process has died; the listener says so in a moment

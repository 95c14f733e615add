"""The service: messages to systemd, the request to stop, the wait at the start, supervision of its threads."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import TypeVar

from vaoi_station.errors import VaoiError
from vaoi_station.supervised_thread import SupervisedThread, ThreadFault, faults_of

_log = logging.getLogger(__name__)
T = TypeVar("T")
PASSING = frozenset(
    {
        "storage-full",
        "storage-read-only",
        "storage-unavailable",
        "ring-directory",
        "ring-taken",
        "ring-too-large",
        "address-absent",
    }
)
"""Codes of errors whose cause passes by itself, or can be removed while the service waits. Others end the service."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
"""First and longest pause between attempts; each pause is twice the previous one. Each resets systemd's watchdog."""
_SIGNALS = (signal.SIGTERM, signal.SIGINT)
_BY_ITSELF = b"\0"
"""Byte that `request` sends in place of a signal number. No signal has the number 0."""
PERIOD_S = 0.5
"""Time between two checks of the threads, s."""


def notify(state: str) -> bool:
    """Send a message such as `READY=1` to systemd (sd_notify(3)); return False if it was not delivered.

    Outside of systemd, the environment variable NOTIFY_SOCKET is not set, and no message is sent.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    # In the address of an abstract socket, "@" stands for the zero byte (unix(7)).
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
        try:
            channel.sendto(state.encode(), address)
        except OSError:
            # The service must not fail because systemd has gone.
            return False
    return True


class StatusNotice:
    """Sends systemd the line that `systemctl status` shows, after each change. Used by one thread."""

    def __init__(self) -> None:
        self._sent = ""

    def __call__(self, status: str) -> None:
        """Send a status if it differs from the last one; only its first line is shown."""
        if status != self._sent and notify(f"STATUS={status.splitlines()[0] if status else ''}"):
            self._sent = status


class StopRequest:
    """Context manager for the main thread, in which `wait` returns after SIGTERM, SIGINT or a call of `request`.

    On exit it restores the previous signal handlers.
    """

    # A `threading.Event` that a signal handler sets can deadlock: the handler runs in the main thread, possibly while
    # `wait` holds the event's lock. A flag can miss a signal between its check and the wait. Therefore the interpreter
    # writes each signal number to a socket (`signal.set_wakeup_fd`), and `wait` reads from this socket.

    def __init__(self) -> None:
        self._here, self._there = socket.socketpair()
        self._there.setblocking(False)

    def request(self) -> None:
        """Request the stop of the service; may be called from any thread, at any time."""
        # An error is harmless: a full socket already holds requests, and a closed socket means that the service has
        # ended.
        with contextlib.suppress(OSError):
            self._there.send(_BY_ITSELF)

    def wait(self, timeout_s: float | None = None) -> str | None:
        """Wait for a request to stop; return the name of the signal, or "" after a call of `request`.

        Return None if `timeout_s` passes without a request.
        """
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
            if not select.select([self._here], [], [], left_s)[0]:
                return None
            number = self._here.recv(1)[0]
            if number == _BY_ITSELF[0]:
                return ""
            # The interpreter also writes the numbers of other signals that have a Python handler. These are ignored.
            if number in _SIGNALS:
                return signal.Signals(number).name

    def __enter__(self) -> StopRequest:
        self._descriptor = signal.set_wakeup_fd(self._there.fileno(), warn_on_full_buffer=False)
        self._handlers = {number: signal.signal(number, _ignore_signal) for number in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._descriptor)
        self._here.close()
        self._there.close()


def _ignore_signal(_number: int, _frame: FrameType | None) -> None:
    """Replace the default action of the signal, which would end the process; its number is in the socket already."""


def until_started(
    stop: StopRequest, start: Callable[[], T], report: Callable[[VaoiError], None] = lambda _: None
) -> T | None:
    """Try to start something until it succeeds, and return what `start` returns; None if a stop was requested first.

    Without this, the service would end and be started again, and systemd might give up after some attempts. `start`
    has undone its changes if it raises an error; `report` gets the error of every attempt whose cause may pass.

    Raises:
        VaoiError: the cause does not pass.
    """
    pause_s, logged, show_status = FIRST_PAUSE_S, "", StatusNotice()
    while True:
        try:
            return start()
        except VaoiError as error:
            if error.code not in PASSING:
                raise
            if error.message != logged:
                logged = error.message
                _log.warning("waiting: %s", error)
            report(error)
            show_status(f"waiting: {error}")
        # The service runs, although it does not film yet: so the command that started it need not wait.
        notify("READY=1")
        notify("WATCHDOG=1")
        if stop.wait(pause_s) is not None:
            return None
        pause_s = min(2 * pause_s, LONGEST_PAUSE_S)


class Supervisor:
    """Checks threads twice a second, and reports each that has ended or hangs, once.

    Its own end or hang is noticed as well: systemd's watchdog is then not reset.
    """

    def __init__(self, alive: Callable[[], object], on_faults: Callable[[Sequence[ThreadFault]], object]) -> None:
        """Begin without threads; `alive` is called after every check without a fault, `on_faults` with new ones."""
        self._alive, self._on_faults = alive, on_faults
        self._watched: tuple[SupervisedThread, ...] = ()
        self._reported: set[str] = set()
        self._stopping = threading.Event()
        self.thread = SupervisedThread(self._run, "supervisor")

    def watch(self, *threads: SupervisedThread) -> None:
        """Add threads to those that are checked; those that have ended as they were asked to are checked no more."""
        self._watched = (*(thread for thread in self._watched if not thread.has_ended), *threads)

    def faults(self) -> tuple[ThreadFault, ...]:
        """Return one fault for each thread that has ended or hangs now. Call it from any thread."""
        return faults_of((*self._watched, self.thread))

    def start(self) -> None:
        """Start to check the threads."""
        self.thread.start()

    def stop(self) -> None:
        """Stop checking the threads."""
        self.thread.expect_end()
        self._stopping.set()
        if self.thread.ident is not None and threading.current_thread() is not self.thread:
            self.thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(PERIOD_S):
            self.thread.beat()
            faults = faults_of(self._watched)
            if not faults:
                self._alive()
            new = [fault for fault in faults if fault.thread not in self._reported]
            self._reported = {fault.thread for fault in faults}
            if new:
                self._on_faults(new)

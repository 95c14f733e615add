"""A request to stop the service. It comes from a signal or from any thread; the main thread waits for it."""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import time
from types import FrameType

_SIGNALS = (signal.SIGTERM, signal.SIGINT)
_BY_ITSELF = b"\0"
"""Byte that `request` sends in place of a signal number. No signal has the number 0."""


class StopRequest:
    """Context manager for the main thread, in which `wait` returns after SIGTERM, SIGINT or a call of `request`.

    On exit it restores the previous signal handlers.
    """

    # A `threading.Event` that is set by a signal handler can deadlock: the handler runs in the waiting main thread,
    # possibly while `wait` holds the event's lock. A flag that is checked before each wait can miss a signal that comes
    # between check and wait. Therefore the interpreter writes each signal number to a socket (`signal.set_wakeup_fd`),
    # and `wait` reads from this socket.

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
    """Do nothing. This handler replaces the default action of the signal, which would end the process.

    The interpreter has already written the signal number into the socket.
    """

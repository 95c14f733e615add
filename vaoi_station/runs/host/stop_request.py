"""A request to stop the service, from a signal or a thread, awaited by the main thread."""

from __future__ import annotations

import contextlib
import signal
import socket
from types import FrameType

_SIGNALS = (signal.SIGTERM, signal.SIGINT)
_BY_ITSELF = b"\0"


class StopRequest:
    """A context manager of the main thread: SIGTERM, SIGINT or `request` end `wait`.

    On exit the previous signal handlers are restored.
    """

    # A `threading.Event` set by a signal handler can deadlock: the handler runs in the waiting main thread, possibly
    # while `wait` holds the event's lock. Other locks have a gap between the last check and the wait, in which a
    # signal is lost. Therefore the interpreter writes each signal number into a socket (`signal.set_wakeup_fd`), and
    # `wait` reads from it.

    def __init__(self) -> None:
        self._here, self._there = socket.socketpair()
        self._there.setblocking(False)

    def request(self) -> None:
        """Request the end, from any thread, at any time."""
        # A full socket already holds requests; a closed one belongs to a service that has ended.
        with contextlib.suppress(OSError):
            self._there.send(_BY_ITSELF)

    def wait(self) -> str:
        """Wait for the first request; return the signal's name, or "" for a call of `request`."""
        while True:
            number = self._here.recv(1)[0]
            if number == _BY_ITSELF[0]:
                return ""
            # Other signals with a Python handler are written to the socket as well.
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
    """Replace the default action, which would end the process; the socket holds the number already."""

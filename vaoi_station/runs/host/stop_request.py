"""The wish that a service end: said by a signal or by one of its threads, awaited by its main thread."""

from __future__ import annotations

import contextlib
import signal
import socket
from types import FrameType

_SIGNALS = (signal.SIGTERM, signal.SIGINT)
_BY_ITSELF = b"\0"


class StopRequest:
    """SIGTERM, SIGINT or `request` end `wait`; a context manager of the main thread, which puts everything back.

    Not a `threading.Event` that a handler sets: the handler runs in the thread that waits, and when it comes
    upon `wait` while that holds the event's lock, both stay for ever. Nor any other lock: a signal between the
    last look and the wait would be slept through. The interpreter writes the number of every signal into a
    socket at once (`signal.set_wakeup_fd`), and reading that is all that is waited for.
    """

    def __init__(self) -> None:
        self._here, self._there = socket.socketpair()
        self._there.setblocking(False)

    def request(self) -> None:
        """Wish for the end, from any thread, at any time."""
        with contextlib.suppress(OSError):  # full: asked often enough; closed: it has ended
            self._there.send(_BY_ITSELF)

    def wait(self) -> str:
        """Wait for the first wish: the name of the signal, or "" if it was `request`."""
        while True:
            number = self._here.recv(1)[0]
            if number == _BY_ITSELF[0]:
                return ""
            if number in _SIGNALS:
                return signal.Signals(number).name

    def __enter__(self) -> StopRequest:
        self._descriptor = signal.set_wakeup_fd(self._there.fileno(), warn_on_full_buffer=False)
        self._handlers = {number: signal.signal(number, _noted) for number in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._descriptor)
        self._here.close()
        self._there.close()


def _noted(_number: int, _frame: FrameType | None) -> None:
    """Stands for the default action, which would end the process; the socket has the number already."""

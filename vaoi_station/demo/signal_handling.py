"""Handle Ctrl-C and SIGTERM once, so that the clean-up that follows is not interrupted."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130
"""Exit code of a command that was interrupted before it had finished (128 + SIGINT, as shells report it)."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt on the first signal and ignore later ones; restore the handlers at the end."""

    def interrupt(number: int, _: FrameType | None) -> None:
        # A second Ctrl-C during the clean-up would leave processes, folders and shared memory behind.
        for each in _SIGNALS:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt(signal.Signals(number).name)

    before = {number: signal.signal(number, interrupt) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

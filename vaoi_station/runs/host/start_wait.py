"""Wait at the start for causes that pass: a full disk, a directory that is not mounted yet, memory that is in use.

Without this, the service would end and be started again, and systemd might give up after some attempts.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeVar

from vaoi_station.errors import VaoiError
from vaoi_station.runs.host.stop_request import StopRequest
from vaoi_station.runs.host.systemd import StatusNotice, notify, notify_watchdog

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


class StartWait:
    """Tries to start something until it succeeds, or fails for a cause that does not pass."""

    def __init__(self, stop: StopRequest) -> None:
        """Prepare to wait until the start succeeds, or until `stop` is requested."""
        self._stop = stop
        self._status = StatusNotice()

    def until_started(self, start: Callable[[], T], report: Callable[[VaoiError], None] = lambda _: None) -> T | None:
        """Return what `start` returns; None if a stop was requested first.

        Args:
            start: makes one attempt. If it raises an error, it has undone its changes.
            report: function that is called with the error of every attempt whose cause may pass.

        Raises:
            VaoiError: the cause does not pass.
        """
        pause_s, logged = FIRST_PAUSE_S, ""
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
                self._status(f"waiting: {error}")
            # The service runs, although it does not film yet: so the command that started it need not wait.
            notify("READY=1")
            notify_watchdog()
            if self._stop.wait(pause_s) is not None:
                return None
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

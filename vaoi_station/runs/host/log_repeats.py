"""A limit for repeated log messages, so that one fault cannot fill the log and hide the others."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

WINDOW_S = 60.0
SAME_TEXT, SAME_TEMPLATE = 5, 100
"""Largest numbers of records within `WINDOW_S` that are logged.

The first is for records with the same text, the second for warnings that differ only in their values."""
ENDED_AT_ONCE = 8
"""Number of the oldest windows that are examined with each record, so that those that have ended do not pile up."""
MOST_KEYS = 2000
"""Largest number of windows in memory; beyond it, the oldest windows are closed first."""

_Key = tuple[str, int, str]


@dataclass
class _Window:
    """The count of records with one key since the time at which the window began."""

    since_s: float
    count: int = 0
    dropped: int = 0


class RepeatLimit(logging.Filter):
    """Filter that drops records that are logged too often, and reports their number after the window has ended."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock, self._lock = clock, threading.Lock()
        # Two tables, so that many different texts do not close the window of their common template.
        self._texts: dict[_Key, _Window] = {}
        self._templates: dict[_Key, _Window] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return False for a record over a limit. The first record after a window states how many it dropped."""
        text = (record.name, record.levelno, record.getMessage())
        template = (record.name, record.levelno, str(record.msg))
        with self._lock:
            now = self._clock()
            dropped, open_ = _count(self._texts, text, now, SAME_TEXT)
            if record.levelno >= logging.WARNING:
                more, also = _count(self._templates, template, now, SAME_TEMPLATE)
                # The same record must not be counted as dropped for both reasons.
                dropped, open_ = max(dropped, more), open_ and also
        if not open_:
            return False
        if dropped:
            record.msg = f"{record.getMessage()} [{dropped} more in {WINDOW_S:.0f} s were not logged]"
            record.args = None
        return True


def _count(windows: dict[_Key, _Window], key: _Key, now: float, limit: int) -> tuple[int, bool]:
    """Count a record; return how many the previous window dropped, and whether this record is within the limit."""
    # Most texts name a run and never come again. A window that has dropped records stays: it is to state their number.
    for old in list(islice(windows, ENDED_AT_ONCE)):
        if old != key and not windows[old].dropped and now - windows[old].since_s >= WINDOW_S:
            del windows[old]
    window, dropped = windows.get(key), 0
    if window is None or now - window.since_s >= WINDOW_S:
        dropped = window.dropped if window else 0
        windows.pop(key, None)  # A new entry goes to the end, because entries are ordered by age.
        if len(windows) >= MOST_KEYS:
            del windows[next(iter(windows))]
        window = windows[key] = _Window(now)
    window.count += 1
    if window.count <= limit:
        return dropped, True
    window.dropped += 1
    return dropped, False

"""The numbered log of what happened: kept in the store, waited for by many, without gaps."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque

from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.store import EventRow, Store

_log = logging.getLogger(__name__)

RECENT = 1000
"""Events served from memory; older ones come from the store."""
_TROUBLES = frozenset({"trouble", "board-missed", "process"})


class EventLog:
    """Appends from one thread, reads and waits from any."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._news = threading.Condition()
        self._recent: deque[EventRecord] = deque(maxlen=RECENT)
        self._last = store.last_event()
        self._closed = False

    @property
    def last(self) -> int:
        """Number of the newest event; 0 before the first."""
        return self._last

    def add(
        self, kind: str, message: str, *, state: str = "", run: str | None = None, code: str = "", action: str = ""
    ) -> EventRecord:
        """Append an event and wake who waits for one."""
        with self._news:
            event = EventRecord(
                number=self._last + 1, time=utc(), kind=kind, state=state, run=run,
                code=code, message=message, action=action,
            )  # fmt: skip
            self._store.add_event(EventRow(event.number, event.model_dump_json()))
            self._recent.append(event)
            self._last = event.number
            self._news.notify_all()
        level = logging.WARNING if kind in _TROUBLES else logging.INFO
        _log.log(level, "%s%s: %s", kind, f" {run}" if run else "", f"{message} {action}".strip())
        return event

    def read(self, after: int, timeout_s: float, limit: int) -> tuple[EventRecord, ...]:
        """Events numbered above `after`, oldest first; waits up to `timeout_s` for one."""
        deadline = time.monotonic() + timeout_s
        with self._news:
            while self._last <= after and not self._closed:
                if not self._news.wait(deadline - time.monotonic()) and time.monotonic() >= deadline:
                    return ()
            if self._recent and self._recent[0].number <= after + 1:
                return tuple(e for e in self._recent if e.number > after)[:limit]
        return tuple(EventRecord.model_validate_json(row.document) for row in self._store.events(after, limit))

    def close(self) -> None:
        """Wake everybody who waits; there will be no more events."""
        with self._news:
            self._closed = True
            self._news.notify_all()

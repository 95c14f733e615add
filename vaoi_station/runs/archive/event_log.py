"""The event log: events are numbered without gaps and kept in the database; callers can wait for the next event."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from pydantic import ValidationError

from vaoi_station.errors import StateError
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.store import Store

_log = logging.getLogger(__name__)

RECENT = 1000
"""Number of the latest events that are kept in memory. Older events are read from the database."""
_NOTHING: Mapping[str, str] = MappingProxyType({})
_WARNINGS = frozenset({"trouble", "board-missed", "process", "push"})
"""Kinds of events that are logged at level WARNING. All others are logged at level INFO."""


class EventLog:
    """The events of the station, in memory and in the database. Its methods may be called from any thread."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._changed = threading.Condition()
        self._recent: deque[EventRecord] = deque(maxlen=RECENT)
        self._last = store.last_event()
        self._closed = False

    @property
    def last(self) -> int:
        """Number of the newest event; 0 if there is no event yet."""
        return self._last

    def add(
        self,
        kind: str,
        message: str,
        *,
        state: str = "",
        run: str | None = None,
        code: str = "",
        action: str = "",
        subject: Mapping[str, str] = _NOTHING,
    ) -> EventRecord:
        """Append an event to the log, and wake all callers that wait for a new event.

        `subject` names the `board` or the `camera` that the event concerns, for the log of the machine.
        """
        with self._changed:
            event = EventRecord(
                number=self._last + 1, time=utc(), kind=kind, state=state, run=run,
                code=code, message=message, action=action,
            )  # fmt: skip
            # The number is assigned and the event is written under one lock, so that the database receives the events
            # in the order of their numbers. When the station stops, the last events may come after the database was
            # closed; they are in the log.
            with contextlib.suppress(StateError):
                self._store.add_event(event.number, event.model_dump_json())
            self._recent.append(event)
            self._last = event.number
            self._changed.notify_all()
        # The log is written outside the lock: a slow log must not delay readers.
        level = logging.WARNING if kind in _WARNINGS else logging.INFO
        fields = {"event": kind, "run": run, "code": code, **subject}
        text = f"{message} {action}".strip()
        _log.log(level, "%s%s: %s", kind, f" {run}" if run else "", text, extra=fields)
        return event

    def read(self, after: int, timeout_s: float, limit: int) -> tuple[EventRecord, ...]:
        """Return at most `limit` events with numbers above `after`, oldest first.

        If there is no such event yet, wait for one up to `timeout_s`; after that, return an empty tuple.
        """
        # `wait` may return although no event was added: each pass computes the remaining time anew.
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while self._last <= after and not self._closed:
                if not self._changed.wait(deadline - time.monotonic()) and time.monotonic() >= deadline:
                    return ()
            if self._recent and self._recent[0].number <= after + 1:
                return tuple(e for e in self._recent if e.number > after)[:limit]
        return _all_parsed(self._store.events(after, limit))

    def latest(self, kind: str, before: int) -> tuple[EventRecord, ...]:
        """Return the latest event of each code of a kind, of the stored ones with numbers below `before`."""
        return _all_parsed(self._store.latest_events(kind, before))

    def close(self) -> None:
        """Wake all callers that wait for an event, because no more events will follow."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


def _all_parsed(texts: Iterable[str]) -> tuple[EventRecord, ...]:
    """Return stored events without those that another version wrote in a way that cannot be read."""
    found = []
    for text in texts:
        with contextlib.suppress(ValidationError):
            found.append(EventRecord.model_validate_json(text))
    return tuple(found)

"""An event log in memory, for deliveries."""

from __future__ import annotations

import threading
import time

from vaoi_station.runs.states.schemas import EventRecord


class EventList:
    """Numbered events, as the event log of a station has them."""

    def __init__(self, first: int = 1) -> None:
        self._first, self._changed = first, threading.Condition()
        self.records: list[EventRecord] = []

    @property
    def last(self) -> int:
        return self._first - 1 + len(self.records)

    def read(self, after: int, timeout_s: float, limit: int) -> tuple[EventRecord, ...]:
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while self.last <= after and (left := deadline - time.monotonic()) > 0:
                self._changed.wait(left)
            return tuple(record for record in self.records if record.number > after)[:limit]

    def latest(self, kind: str, before: int) -> tuple[EventRecord, ...]:
        return tuple({r.code: r for r in self.records if r.kind == kind and r.number < before}.values())

    def add(
        self, kind: str, message: str, *, state: str = "", run: str | None = None, code: str = "", action: str = ""
    ) -> EventRecord:
        with self._changed:
            record = EventRecord(
                number=self.last + 1, time="2026-01-01T12:00:00.000Z", kind=kind, state=state, run=run, code=code,
                message=message, action=action,
            )  # fmt: skip
            self.records.append(record)
            self._changed.notify_all()
        return record

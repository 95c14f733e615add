"""The thread that publishes the events of the log to a broker: in order, each at least once, over restarts."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from vaoi_station.config import StationConfig
from vaoi_station.errors import VaoiError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.model import Reason
from vaoi_station.push.broker import OWN_KIND, Broker, Outcome
from vaoi_station.push.cfx import CfxBroker
from vaoi_station.push.cfx_messages import Facts
from vaoi_station.push.mqtt import MqttBroker, type_of
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

FOLDER = "push"
FORMAT, VERSION = "vaoi-push-state", 1
PAUSES_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Pauses after failed attempts, s; the last one is repeated."""
MOST_WAITING = 10_000
"""Number of events that wait for a broker that is away; beyond it all but the newest half of them are skipped."""
FAILING_AFTER = 2
"""Number of failed attempts in a row after which the broker counts as lost."""
BATCH, READ_S = 50, 0.5
"""Number of events that are read at once, and longest wait for them, s: the thread ends within this time."""
SAVE_S = 1.0
"""Shortest time between two writes of the state, s. After a power cut the messages of this time are repeated."""
LAST_S = 1.0
"""Time in which the last events are published when the station stops, s."""
FAULT_PAUSE_S, STOP_S = 5.0, 3.0
"""Pause after an error of this program, and longest wait for the attempt under way when the station stops, s."""
_UNREADABLE = "the log does not have them any more, or cannot read them"
Count = Annotated[int, Field(ge=0)]


class PublisherState(BaseModel):
    """What was published, for the next start. It is replaced as a whole, so that any thread may read it."""

    # Earlier versions stored more fields.
    model_config = ConfigDict(frozen=True, extra="ignore")

    format: str = FORMAT
    version: int = VERSION
    last: Count
    """Number of the last event that was published, skipped, or not wanted."""
    delivered: Count = 0
    failures: Count = 0
    skipped: Count = 0
    """Events that were not sent because too many waited, or that the log had deleted."""


def is_wanted(record: EventRecord, types: Sequence[str]) -> bool:
    """Return whether an event is of one of the types; no types stand for all."""
    kind, names = type_of(record), [name.replace("-", "_") for name in types]
    return record.kind != OWN_KIND and (not names or any(f"{kind}.".startswith(f"{name}.") for name in names))


class Publisher:
    """Publishes the wanted events to one broker."""

    def __init__(self, name: str, path: Path, events: EventLog, broker: Broker) -> None:
        """Prepare the thread; its state is in the file `path`. Without the file it begins with the next event."""
        self.name, self._path, self._events, self._broker = name, path, events, broker
        self.state = read_state(path, events.last)
        self._saved: PublisherState | None = None
        self._saved_at_s, self._earlier = 0.0, events.last
        self._in_a_row, self._fault, self._due_s = 0, "", 0.0
        self._waiting: deque[EventRecord] = deque()
        self._stopping = threading.Event()
        self.thread = SupervisedThread(self._run, f"push {name}")

    @classmethod
    def of(cls, config: StationConfig, events: EventLog, facts: Facts) -> tuple[Publisher, ...]:
        """Return the publishers of a station, one for each broker; DeviceError if one lacks its library."""
        found: dict[str, tuple[str, Broker]] = {}
        if (mqtt := config.push.mqtt) is not None:
            found["mqtt"] = mqtt.host, MqttBroker(mqtt, config.name, lambda: str(facts.snapshot().state))
        if (cfx := config.push.cfx) is not None:
            found["cfx"] = cfx.host, CfxBroker(cfx, config.name, events, facts, config.hermes is not None)
        return tuple(
            cls(f"{kind}:{host}", config.data / FOLDER / f"{kind}.json", events, broker)
            for kind, (host, broker) in found.items()
        )

    def running(self, watch: Callable[[SupervisedThread], object]) -> AbstractContextManager[None]:
        """Publish during a `with` block; `watch` supervises the thread."""
        return self.thread.serving(watch, self._stopping.set, STOP_S)

    @property
    def waiting(self) -> int:
        """Number of events of the log that have not had their turn."""
        return max(0, self._events.last - self.state.last)

    @property
    def is_failing(self) -> bool:
        """Whether attempts fail repeatedly."""
        return self._in_a_row >= FAILING_AFTER

    def reasons(self) -> tuple[Reason, ...]:
        """Return the warning about a broker that is lost; none while it accepts messages."""
        return (self._lost(),) if self.is_failing else ()

    def _lost(self) -> Reason:
        what = f"{self._broker.what} {self.name!r}"
        message = f"{what} does not accept messages: {self._fault} {self.waiting} events wait."
        action = "Check broker, address, user and certificate; it is tried again by itself."
        return Reason(code=self._broker.code, message=message, action=action)

    def _run(self) -> None:
        # Names are resolved for as long as the resolver takes: the silence of this thread is no fault.
        with self.thread.waiting():
            self._save()  # it says where the first start began
            while not self._stopping.is_set():
                try:
                    self._pass()
                except Exception:  # noqa: BLE001  a fault here must not end the station
                    _log.exception("push to %s failed; it is tried again", self.name)
                    self._stopping.wait(FAULT_PAUSE_S)
            self._publish_last()
            self._broker.close()
            self._save()

    def _publish_last(self) -> None:
        """Publish the last events, which say that the station stops; one that fails gets them at the next start."""
        end_s, before = time.monotonic() + LAST_S, -1
        with suppress(Exception):  # of the database, which is closed next
            while self.waiting and not self._in_a_row and before < self.state.last and time.monotonic() < end_s:
                before = self.state.last
                self._pass()

    def _pass(self) -> None:
        """Make one attempt, or wait a moment."""
        self._broker.tend()
        left_s = self._due_s - time.monotonic()
        outcome = None
        if left_s > 0:
            self._stopping.wait(min(left_s, READ_S))
        elif (record := self._next()) is None:
            outcome = self._tried(self._broker.idle)
        else:
            outcome = self._tried(lambda: self._broker.send(record))
            if outcome is not None and outcome.delivered:
                self._waiting.popleft()
                self._change(last=record.number, delivered=self.state.delivered + 1)
        if outcome is not None:
            self._note(outcome)
        if time.monotonic() - self._saved_at_s > SAVE_S:
            self._save()

    def _tried(self, attempt: Callable[[], Outcome | None]) -> Outcome | None:
        try:
            return attempt()
        except Exception as error:  # noqa: BLE001  a fault of the library is a failed attempt
            _log.warning("push to %s failed", self.name, exc_info=True)
            return Outcome(False, f"{type(error).__name__}: {error}.")

    def _next(self) -> EventRecord | None:
        """Return the next event that is wanted; None if there is none yet."""
        if self.waiting > MOST_WAITING:
            # More than needed, because the report of it is an event too.
            self._skip(self._events.last - MOST_WAITING // 2, "too many waited")
        if not self._waiting:
            begun_s = time.monotonic()
            self._waiting.extend(self._read())
            if not self._waiting and time.monotonic() - begun_s < READ_S / 2:
                self._stopping.wait(READ_S)  # the log is closed: the station is stopping
        while self._waiting:
            record = self._waiting[0]
            if record.number > self.state.last + 1:
                self._skip(record.number - 1, _UNREADABLE)
            if is_wanted(record, self._broker.kinds):
                return record
            self._waiting.popleft()
            self._change(last=record.number)
        return None

    def _read(self) -> tuple[EventRecord, ...]:
        """Return the next events; pass over those that cannot be read, which another version may have written."""
        after = self.state.last
        records = self._events.read(after, READ_S, BATCH)
        # Only those of earlier starts: an event of this one may be absent because the disk takes no writes at present.
        while not records and after < self._earlier:
            after = min(after + BATCH, self._earlier)
            records = self._events.read(after, READ_S, BATCH)
        if not records and after > self.state.last:
            self._skip(after, _UNREADABLE)
        return records

    def _skip(self, last: int, why: str) -> None:
        """Leave out the events up to a number, and report it."""
        count = last - self.state.last
        self._change(last=last, skipped=self.state.skipped + count)
        while self._waiting and self._waiting[0].number <= last:
            self._waiting.popleft()
        message = f"{self._broker.what} {self.name!r} does not get {count} events up to number {last}: {why}."
        self._events.add(OWN_KIND, message, code="events-not-pushed", action="Read them with GET events?after=.")

    def _note(self, outcome: Outcome) -> None:
        """Note what became of an attempt; report when the broker is lost, and when it is reached again."""
        was_failing = self.is_failing
        if outcome.delivered:
            self._in_a_row, self._fault = 0, ""
            if was_failing:
                self._events.add(OWN_KIND, f"{self._broker.what} {self.name!r} is reached again.")
        elif not self._stopping.is_set():  # otherwise it may have failed because the station stops
            self._in_a_row, self._fault = self._in_a_row + 1, outcome.detail
            self._due_s = time.monotonic() + PAUSES_S[min(self._in_a_row, len(PAUSES_S)) - 1]
            self._change(failures=self.state.failures + 1)
            _log.info("push to %s: attempt %d failed: %s", self.name, self._in_a_row, outcome.detail)
            if self.is_failing and not was_failing:
                lost = self._lost()
                self._events.add(OWN_KIND, lost.message, code=lost.code, action=lost.action)

    def _change(self, **changes: int) -> None:
        self.state = self.state.model_copy(update=changes)

    def _save(self) -> None:
        self._saved_at_s = time.monotonic()
        if self.state is self._saved:
            return
        try:
            write_json(self._path, self.state.model_dump(mode="json"))
        except VaoiError as error:
            # After a crash messages would be repeated, which subscribers notice by the numbers; the line goes on.
            _log.warning("%s", error)
        self._saved = self.state


def read_state(path: Path, newest: int) -> PublisherState:
    """Read the state; one that is absent or damaged begins after the event `newest`."""
    try:
        if path.exists():
            data = read_json(path)
            check_format(data, path, FORMAT, VERSION)
            state = parse(PublisherState, data, path)
            # After a restored backup the log is shorter: its next events have numbers that were used before.
            return state.model_copy(update={"last": min(state.last, newest)})
    except VaoiError as error:
        _log.error("%s Publishing continues with the next event.", error)
    return PublisherState(last=newest)

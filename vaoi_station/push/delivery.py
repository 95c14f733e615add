"""The delivery loop: one thread that sends the events of the log to one receiver, in order, each at least once."""

from __future__ import annotations

import logging
import random
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

from vaoi_station.errors import NotFoundError, StateError, VaoiError
from vaoi_station.push.delivery_state import DeadLetter, DeliveryState, delete_state, read_state, write_state
from vaoi_station.push.messages import OWN_KIND, Message, is_wanted, message_of, type_of
from vaoi_station.push.transport import Outcome, Transport
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import EventRecord, Reason
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)
T = TypeVar("T")
READ_S = 0.5
"""Longest wait for an event; a request for this thread takes effect within this time."""
SAVE_S = 1.0
"""Shortest time between two writes of the state while deliveries succeed. After a power cut the deliveries of this time
are repeated, with the same ids."""
BATCH = 50
FAULT_PAUSE_S = 5.0
REPORTED_AFTER = 2
"""Number of failed attempts for one event after which the receiver counts as failing."""
DISABLED_AFTER_S = 5 * 86400.0
"""Time without a single delivery after which a receiver is disabled, s. The time when the station is off is no part of
it, and the clock of the machine has no effect on it."""
_NOT_THERE = "the log does not have them any more, or cannot read them"
JITTER = 0.1
"""Largest random extension of a pause, as its share."""


class Events(Protocol):
    """The part of the event log that a delivery uses."""

    @property
    def last(self) -> int:
        """Number of the newest event."""

    def read(self, after: int, timeout_s: float, limit: int) -> tuple[EventRecord, ...]:
        """Return events with numbers above `after`; wait for the first of them."""

    def add(self, kind: str, message: str, *, code: str = "", action: str = "") -> EventRecord:
        """Append an event."""


class Rules(NamedTuple):
    """Which events a receiver gets, and what happens when a delivery fails."""

    types: tuple[str, ...]
    pauses_s: tuple[float, ...]
    """Pause before each further attempt."""
    gives_up: bool = True
    """Whether an event becomes a dead letter after the last pause, and a receiver is disabled after
    `DISABLED_AFTER_S`. Otherwise the last pause is repeated."""
    most_waiting: int | None = None
    """Number of events that may wait; beyond it all but the newest half of them are skipped. None: as many as the log
    keeps."""


class Words(NamedTuple):
    """How reports name one kind of receiver, and the codes and actions of the reports; their messages are replaced."""

    noun: str
    failing: Reason
    disabled: Reason
    skipped: Reason


class Delivery:
    """Delivers events to one receiver. Its methods may be called from any thread."""

    def __init__(
        self, name: str, path: Path, events: Events, station: str, words: Words, *, is_new: bool = False
    ) -> None:
        """Prepare a delivery whose state is in the file `path`. `set` gives it transport and rules.

        A new receiver begins with the next event, whatever the file holds of an earlier one of its name.
        """
        self.name, self._words = name, words
        self._path, self._events, self._station, self._earlier = path, events, station, events.last
        self._state = DeliveryState(last=events.last) if is_new else read_state(path, lambda: events.last)
        self._saved = self._state if path.exists() and not is_new else None
        self._saved_at_s, self._save_failed = 0.0, False
        self._failing_at_s = time.monotonic()  # until when `failing_s` of the state counts
        self._transport: Transport | None = None
        self._rules = Rules((), (READ_S,))
        self._batch: deque[EventRecord] = deque()
        self._orders: deque[tuple[Callable[[], object], Future[object]]] = deque()
        self._wake, self._lock, self._file_lock = threading.Event(), threading.Lock(), threading.Lock()
        self._stopping = self._forgotten = self._ended = False
        self.thread = SupervisedThread(self._run, f"push {name}")

    @property
    def state(self) -> DeliveryState:
        """The present state."""
        return self._state

    @property
    def waiting(self) -> int:
        """Number of events of the log that have not had their turn."""
        return max(0, self._events.last - self._state.last)

    @property
    def is_failing(self) -> bool:
        """Whether deliveries fail repeatedly."""
        return bool(self._state.disabled) or self._state.in_a_row >= REPORTED_AFTER

    def warning(self) -> Reason | None:
        """Return the warning about a receiver that fails or is disabled; None if it does neither."""
        if not self.is_failing:
            return None
        state = self._state
        what = f"is disabled: {state.disabled}" if state.disabled else f"does not accept messages: {state.fault}"
        message = f"{self._words.noun} {self.name!r} {what} {self.waiting} events wait."
        kind = self._words.disabled if state.disabled else self._words.failing
        return kind.model_copy(update={"message": message})

    def set(self, transport: Transport, rules: Rules) -> None:
        """Use another transport and other rules from the next attempt on."""
        old, self._transport, self._rules = self._transport, transport, rules
        if old is not None:
            self.submit(old.close)

    def start(self) -> None:
        """Start the thread."""
        self._failing_at_s = time.monotonic()
        self.thread.start()

    def stop(self, *, forget: bool = False) -> None:
        """End the thread after the attempt that is under way; with `forget`, delete the state now."""
        self.thread.expect_end()
        self._stopping = True
        if forget:
            # The thread may end later than a new receiver of this name begins, whose file it must not touch.
            with self._file_lock:
                self._forgotten = True
                delete_state(self._path)
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread."""
        if self.thread.is_alive():
            self.thread.join(timeout_s)

    def submit(self, work: Callable[[], T]) -> Future[T]:
        """Run `work` in the thread, between two attempts."""
        future: Future[T] = Future()
        # Under a lock: a request that is queued after the end would never have a reply.
        with self._lock:
            if self._ended:
                future.set_exception(_ended())
            else:
                self._orders.append((work, future))  # type: ignore[arg-type]
        self._wake.set()
        return future

    # --- requests of an administrator

    def test(self, message: Message) -> Future[Outcome]:
        """Send a message now, whatever the state; its outcome changes nothing."""
        return self.submit(lambda: self._send(message))

    def enable(self) -> Future[DeliveryState]:
        """Deliver again after the receiver was disabled, and make the next attempt at once."""

        def work() -> DeliveryState:
            self._state = self._state.enabled()
            return self._state

        return self.submit(work)

    def retry(self, number: int) -> Future[Outcome]:
        """Send a dead letter once more; it is removed if the receiver accepts it."""

        def work() -> Outcome:
            letter = self.letter(number)
            outcome = self._send(message_of(letter.event, self._station))
            if outcome.delivered:
                self._state = self._state.without_letter(number)
                self._change(delivered=self._state.delivered + 1)
            return outcome

        return self.submit(work)

    def drop(self, number: int) -> Future[None]:
        """Remove a dead letter."""

        def work() -> None:
            self.letter(number)
            self._state = self._state.without_letter(number)

        return self.submit(work)

    def letter(self, number: int) -> DeadLetter:
        """Return the dead letter of an event. `NotFoundError`: there is none."""
        found = next((letter for letter in self._state.letters if letter.event.number == number), None)
        if found is None:
            numbers = ", ".join(str(letter.event.number) for letter in self._state.letters[-10:]) or "none"
            raise NotFoundError(
                f"{self.name!r} has no dead letter of event {number}; it has {numbers}.", code="unknown-dead-letter"
            )
        return found

    # --- in the thread

    def _run(self) -> None:
        # Names are resolved for as long as the resolver takes: the silence of this thread is no fault.
        with self.thread.waiting():
            while not self._stopping:
                try:
                    self._pass()
                except Exception:  # noqa: BLE001  a fault here must not end the station
                    _log.exception("push to %s failed; it is tried again", self.name)
                    self._wake.wait(FAULT_PAUSE_S)
            self._end()

    def _pass(self) -> None:
        """Serve the requests, then make one attempt or wait a moment."""
        self._wake.clear()
        while self._orders:
            self._perform(*self._orders.popleft())
            self._save()
        if self._saved is None:
            self._save()  # it says where the receiver begins
        transport, state = self._transport, self._state
        left_s = state.due_s - time.time()
        if left_s > (1 + JITTER) * max(self._rules.pauses_s) + READ_S:
            left_s = 0.0  # the clock was set back
        if transport is None or state.disabled or left_s > 0:
            self._save()
            self._wake.wait(READ_S if transport is None or state.disabled else min(left_s, READ_S))
        elif (record := self._next()) is not None:
            self._note(record, self._send(message_of(record, self._station)))
        elif (outcome := transport.idle()) is not None:
            self._note(None, outcome)

    def _perform(self, work: Callable[[], object], future: Future[object]) -> None:
        if not future.set_running_or_notify_cancel():
            return  # the caller has gone, or has waited long enough
        try:
            future.set_result(work())
        except Exception as error:  # noqa: BLE001  the caller gets it
            future.set_exception(error)

    def _next(self) -> EventRecord | None:
        """Return the next event that the receiver wants; None if there is none yet."""
        most = self._rules.most_waiting
        if most is not None and self.waiting > most:
            # More than needed, because the report of it is an event too.
            self._skip(self._events.last - most // 2, "too many waited")
        if not self._batch:
            begun = time.monotonic()
            self._batch.extend(self._read())
            if not self._batch:
                self._save()
                if time.monotonic() - begun < READ_S / 2:
                    self._wake.wait(READ_S)  # the log is closed: the station is stopping
                return None
        while self._batch:
            record = self._batch[0]
            if record.number > self._state.last + 1:
                self._skip(record.number - 1, _NOT_THERE)
            if is_wanted(record, self._rules.types):
                return record
            self._batch.popleft()
            self._change(last=record.number)
        self._save()
        return None

    def _read(self) -> tuple[EventRecord, ...]:
        """Return the next events; pass over those that cannot be read, which another version may have written."""
        after = self._state.last
        found = self._events.read(after, READ_S, BATCH)
        # Only those of earlier starts: an event of this one may be absent because the disk takes no writes at present.
        while not found and after < self._earlier:
            after = min(after + BATCH, self._earlier)
            found = self._events.read(after, READ_S, BATCH)
        if not found and after > self._state.last:
            self._skip(after, _NOT_THERE)
        return found

    def _skip(self, last: int, why: str) -> None:
        """Leave out the events up to a number, and report it."""
        count = last - self._state.last
        self._change(last=last, skipped=self._state.skipped + count, attempts=0)
        while self._batch and self._batch[0].number <= last:
            self._batch.popleft()
        message = f"{self._words.noun} {self.name!r} does not get {count} events up to number {last}: {why}."
        self._publish(self._words.skipped, message)

    def _note(self, record: EventRecord | None, outcome: Outcome) -> None:
        """Note what became of an attempt for an event, or, with None, of one to connect; report a change."""
        before = self.is_failing
        if outcome.delivered:
            if record is not None:
                self._batch.popleft()
            self._state = self._state.succeeded(record.number if record else None, utc())
            if before:
                self._events.add(OWN_KIND, f"{self._words.noun} {self.name!r} is reached again.")
            if time.monotonic() - self._saved_at_s > SAVE_S:
                self._save()
        elif not self._stopping:  # otherwise it may have failed because the station stops
            self._failed(record, outcome)
            if self.is_failing and (not before or self._state.disabled):
                reason = self.warning()
                assert reason is not None, "it is failing"
                self._publish(reason, reason.message)
            self._save()

    def _failed(self, record: EventRecord | None, outcome: Outcome) -> None:
        """Set the next attempt, give the event up, or disable the receiver."""
        now, state, pauses = time.time(), self._state, self._rules.pauses_s
        failing_s = self._failing_s()
        attempts = state.attempts + 1
        _log.info("push to %s: attempt %d failed: %s", self.name, attempts, outcome.detail)
        pause = max(pauses[min(attempts, len(pauses)) - 1], min(outcome.retry_after_s, max(pauses)))
        due = now + pause * (1 + JITTER * random.random())
        self._state = self._state.failed(outcome.detail, failing_s, due)
        if not self._rules.gives_up or record is None:
            return
        if outcome.gone:
            self._change(disabled="The receiver wants no more messages (status 410).")
        elif failing_s > DISABLED_AFTER_S:
            self._change(disabled=f"No delivery succeeded for {failing_s / 86400:.1f} days.")
        elif attempts > len(pauses):
            self._batch.popleft()
            letter = DeadLetter(event=record, given_up=utc(), attempts=attempts, fault=outcome.detail)
            self._state = self._state.given_up(letter)
            _log.warning("push to %s: event %d (%s) is a dead letter", self.name, record.number, type_of(record))

    def _failing_s(self) -> float:
        """Return for how long deliveries have failed, and count on from now."""
        before, self._failing_at_s = self._failing_at_s, time.monotonic()
        return self._state.failing_s + self._failing_at_s - before if self._state.in_a_row else 0.0

    def _publish(self, kind: Reason, message: str) -> None:
        self._events.add(OWN_KIND, message, code=kind.code, action=kind.action)

    def _send(self, message: Message) -> Outcome:
        assert self._transport is not None, "a pass with a transport only"
        try:
            return self._transport.send(message)
        except Exception as error:  # noqa: BLE001  a fault of a transport is a failed attempt
            _log.warning("push to %s failed", self.name, exc_info=True)
            return Outcome(False, f"{type(error).__name__}: {error}")

    def _change(self, **changes: object) -> None:
        self._state = self._state.model_copy(update=changes)

    def _save(self) -> None:
        if self._state is self._saved:
            return
        self._saved_at_s = time.monotonic()
        try:
            with self._file_lock:
                if not self._forgotten:
                    write_state(self._path, self._state)
        except VaoiError as error:
            # After a crash deliveries would be repeated, which receivers notice by the ids; the line goes on.
            if not self._save_failed:
                _log.warning("%s", error)
            self._save_failed = True
        else:
            self._saved, self._save_failed = self._state, False

    def _end(self) -> None:
        """Close the connection, write the state, and refuse the requests that are left."""
        try:
            if self._transport is not None:
                self._transport.close()
            if self._state.in_a_row:
                self._change(failing_s=self._failing_s())
            self._save()
        finally:
            with self._lock:
                self._ended = True
            for _, future in self._orders:
                if future.set_running_or_notify_cancel():
                    future.set_exception(_ended())
            self._orders.clear()


def _ended() -> StateError:
    return StateError("The receiver was removed, or the station is stopping.")

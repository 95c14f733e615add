"""One thread, one inbox: everything that changes the station's state happens here, one message after another."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, Queue
from typing import Any, ParamSpec, TypeVar

from vaoi_station.errors import InternalError, StateError, VaoiError

_log = logging.getLogger(__name__)
P = ParamSpec("P")
T = TypeVar("T")


class Inbox:
    """Executes what is posted, in order; between messages it calls `tick` at least every `tick_s`."""

    def __init__(self, tick: Callable[[], None], tick_s: float = 0.5) -> None:
        self._tick, self._tick_s = tick, tick_s
        self._messages: Queue[Callable[[], Any]] = Queue()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="coordinator", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def post(self, work: Callable[P, Any], *args: P.args, **kwargs: P.kwargs) -> None:
        """Have a function executed; returns at once."""
        self._messages.put(lambda: work(*args, **kwargs))

    def ask(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Have a function executed and return its result; what it raises is raised here."""
        answer: Future[T] = Future()

        def do() -> None:
            try:
                answer.set_result(work(*args, **kwargs))
            except VaoiError as refusal:
                answer.set_exception(refusal)
            except Exception as fault:  # the caller must not wait for ever; the fault is raised again for the log
                answer.set_exception(InternalError(f"{type(fault).__name__}: {fault}."))
                raise

        return self.wait(answer, do)

    def wait(self, answer: Future[T], do: Callable[[], Any], timeout_s: float | None = None) -> T:
        """Post `do` and wait for an answer that may come later than `do` ends; `TimeoutError` if it does not."""
        if threading.current_thread() is self._thread:
            raise InternalError("The coordinator's thread cannot wait for itself.")
        if self._closed.is_set():
            raise _stopping()
        self._messages.put(do)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            remaining = None if deadline is None else deadline - time.monotonic()
            try:
                # In steps of a second: close() may race with the put above, and then no message is executed any more.
                return answer.result(1.0 if remaining is None else min(max(remaining, 0.0), 1.0))
            except TimeoutError:
                if self._closed.is_set() and not answer.done():
                    raise _stopping() from None
                if deadline is not None and time.monotonic() >= deadline:
                    raise

    def close(self) -> None:
        """Execute what was posted before, then end the thread; later requests are refused."""
        if self._closed.is_set():
            return
        # The flag is set by a message, so that everything posted earlier is still executed.
        self._messages.put(self._closed.set)
        if self._thread.ident is not None:
            self._thread.join()
        self._closed.set()

    def _run(self) -> None:
        next_tick = time.monotonic() + self._tick_s
        while not self._closed.is_set():
            work = self._next(next_tick)
            if work is None:
                work, next_tick = self._tick, time.monotonic() + self._tick_s
            try:
                work()
            except Exception:  # noqa: BLE001  one message that fails must not end the station; it is in the log
                _log.exception("a message to the coordinator failed")

    def _next(self, until_s: float) -> Callable[[], Any] | None:
        """Return the next message; None when the tick is due, even if messages are waiting."""
        try:
            left_s = until_s - time.monotonic()
            return self._messages.get(timeout=left_s) if left_s > 0 else None
        except Empty:
            return None


def _stopping() -> StateError:
    return StateError("The station is stopping.", action="Retry when the station is running again.")

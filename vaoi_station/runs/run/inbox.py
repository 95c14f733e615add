"""The inbox and the thread of the coordinator. All changes of the station's state happen in this thread, one by one."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, Queue
from typing import Any, ParamSpec, TypeVar

from vaoi_station.errors import InternalError, StateError, VaoiError
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)
P = ParamSpec("P")
T = TypeVar("T")


class Inbox:
    """A queue of functions, and the thread that calls them one after another.

    The thread also calls `tick` every `tick_s` seconds, and `after` after each of these calls.
    """

    def __init__(self, tick: Callable[[], None], tick_s: float = 0.5, after: Callable[[], None] = lambda: None) -> None:
        self._tick, self._tick_s, self._after = tick, tick_s, after
        self._messages: Queue[Callable[[], Any]] = Queue()
        self._closed = threading.Event()
        self.thread = SupervisedThread(self._run, "coordinator", urgent=True)

    def start(self) -> None:
        """Start the thread that executes the posted functions."""
        self.thread.start()

    def post(self, work: Callable[P, Any], *args: P.args, **kwargs: P.kwargs) -> None:
        """Let the inbox's thread call a function with these arguments, and return at once."""
        self._messages.put(lambda: work(*args, **kwargs))

    def ask(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Let the inbox's thread call a function, wait for the call, and return what the function returns.

        A `VaoiError` that it raises is raised here; any other exception becomes an `InternalError`.
        """
        answer: Future[T] = Future()

        def do() -> None:
            try:
                answer.set_result(work(*args, **kwargs))
            except VaoiError as refusal:
                answer.set_exception(refusal)
            except Exception as fault:  # the caller must not wait for ever; `raise` below logs the fault
                answer.set_exception(InternalError(f"{type(fault).__name__}: {fault}."))
                raise

        return self.wait(answer, do)

    def wait(self, answer: Future[T], do: Callable[[], Any], timeout_s: float | None = None) -> T:
        """Let the inbox's thread call `do`, wait until `answer` is set, maybe by a later message; return its value.

        Raises:
            TimeoutError: the answer was not set within `timeout_s`.
            StateError: the station is stopping.
        """
        if threading.current_thread() is self.thread:
            raise InternalError("The coordinator's thread cannot wait for itself.")
        if self._closed.is_set():
            raise _stopping()
        self._messages.put(do)
        deadline_s = time.monotonic() + timeout_s if timeout_s is not None else float("inf")
        while True:
            try:
                # Wait in steps of 1 s, and check for the end of the thread after each: if close() ran just before the
                # put above, the message is never executed and no answer comes.
                return answer.result(min(max(deadline_s - time.monotonic(), 0.0), 1.0))
            except TimeoutError:
                if self._closed.is_set() and not answer.done():
                    raise _stopping() from None
                if time.monotonic() >= deadline_s:
                    raise

    def close(self) -> None:
        """Execute all functions posted so far, then end the thread. Later requests are refused."""
        if self._closed.is_set():
            return
        self.thread.expect_end()
        # The flag is set by a message, so that all messages posted before it are still executed.
        self._messages.put(self._closed.set)
        if self.thread.ident is not None:
            self.thread.join()
        self._closed.set()

    def _run(self) -> None:
        next_tick_s = time.monotonic() + self._tick_s
        while not self._closed.is_set():
            self.thread.beat()
            try:
                # A tick that is due comes before waiting messages.
                left_s = next_tick_s - time.monotonic()
                work = self._messages.get(timeout=left_s) if left_s > 0 else None
            except Empty:
                work = None
            if work is None:
                work, next_tick_s = self._tick, time.monotonic() + self._tick_s
            try:
                work()
                self._after()
            except Exception:  # noqa: BLE001  a message that fails must not end the station; the log shows the fault
                _log.exception("a message to the coordinator failed")


def _stopping() -> StateError:
    return StateError("The station is stopping.", action="Retry when the station is running again.")

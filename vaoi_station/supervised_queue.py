"""A bounded queue that one supervised thread serves, so that its owner never waits for the work."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from typing import Generic, TypeVar

from vaoi_station.supervised_thread import SupervisedThread

T = TypeVar("T")

_END_S = 5.0
"""Longest wait for the end of the thread, which may wait for another process."""
_LOOK_S = 0.5
"""Longest time in which the thread does not check whether it is to end."""


class SupervisedQueue(Generic[T]):
    """Passes items to a function, one after the other, in a thread of its own. Methods may be called from any thread.

    The function may take any time: the thread counts as waiting meanwhile, unless the queue is `limited`. It must not
    raise.
    """

    def __init__(
        self,
        serve: Callable[[T], object],
        name: str,
        most: int,
        begin: Callable[[], object] | None = None,
        *,
        limited: bool = False,
    ) -> None:
        """Prepare the queue: beyond `most` waiting items, a further one takes the place of the oldest.

        `begin` is called once in the thread, before the first item. If `limited`, an item that takes as long as no
        supervised thread may is a fault of the thread, and `stop` waits for the item under way.
        """
        self._limited = limited
        self._serve, self._most, self._begin = serve, most, begin
        self._waiting: deque[T] = deque()
        self._wake, self._stop = threading.Condition(), threading.Event()
        self.thread = SupervisedThread(self._run, name)

    @property
    def stopping(self) -> bool:
        """Whether the thread was asked to end: the item under way is to be given up."""
        return self._stop.is_set()

    def pause(self, time_s: float) -> bool:
        """Let the item under way wait, or until the thread was asked to end. Return whether it was."""
        return self._stop.wait(time_s)

    def start(self) -> None:
        """Start the thread."""
        self.thread.start()

    def put(self, item: T) -> T | None:
        """Add an item, and return the oldest one if there is no room for it: it is not served."""
        with self._wake:
            self._waiting.append(item)
            left_out = self._waiting.popleft() if len(self._waiting) > self._most else None
            self._wake.notify_all()
        return left_out

    def stop(self) -> None:
        """End the thread; unless the queue is limited, the item under way is awaited for five seconds at most."""
        self.thread.expect_end()
        with self._wake:
            self._stop.set()
            self._wake.notify_all()
        if self.thread.is_alive():
            self.thread.join(None if self._limited else _END_S)

    def _run(self) -> None:
        if self._begin is not None:
            self._begin()
        while not self._stop.is_set():
            self.thread.beat()
            with self._wake:
                if not self._waiting:
                    self._wake.wait(_LOOK_S)
                if self._stop.is_set() or not self._waiting:
                    continue
                item = self._waiting.popleft()
            with nullcontext() if self._limited else self.thread.waiting():
                self._serve(item)

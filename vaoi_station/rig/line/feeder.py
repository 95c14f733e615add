"""Feed the line: let one board after another pass, each when the station is ready for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from vaoi_station.errors import DeviceError
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.rig.line.virtual_line import BoardPassage, VirtualLine

READY_TIMEOUT_S = 30.0
"""Longest wait for a station that is not ready; then the next board passes nevertheless."""
END_MARGIN_S = 1.0
"""Time from the last pulse of a passage to its end."""


class BoardFeeder:
    """A thread that feeds boards; a context manager that waits for the last one.

    If the chip ends, its DeviceError is raised at the end of the context.
    """

    def __init__(
        self,
        line: VirtualLine,
        boards: Sequence[RenderedBoard],
        interval_s: float,
        wait_ready: Callable[[float], bool] = lambda _: True,
    ) -> None:
        """Prepare the feeder.

        Args:
            line: lets a board pass.
            boards: those that pass, in order.
            interval_s: time between the starts of two passages.
            wait_ready: called with a timeout in seconds; waits until the station takes boards.
        """
        self._line, self._boards, self._interval_s, self._wait_ready = line, boards, interval_s, wait_ready
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="feeder")
        self.passages: list[BoardPassage] = []
        self.finished = threading.Event()
        """Set when all boards have passed, or when no more can."""
        self._failure: DeviceError | None = None

    def __enter__(self) -> BoardFeeder:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        if self._failure is not None and kind is None:
            raise self._failure

    def _work(self) -> None:
        try:
            self._feed()
        except DeviceError as error:
            # The exception must not end in this thread, where only a message would remain; __exit__ raises it.
            self._failure = error
        self.finished.set()

    def _feed(self) -> None:
        due_s = time.monotonic()
        for board in self._boards:
            if self._closing.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._wait_ready(READY_TIMEOUT_S)
            # Counted from the moment the station was ready, so that a slow station does not get two boards at once.
            due_s = time.monotonic() + self._interval_s
            self.passages.append(self._line.start_passage(board))
            if self._closing.wait(board.duration_s + END_MARGIN_S):
                return

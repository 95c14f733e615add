"""Let one board after another pass the line, each as soon as the station is ready and permits the board."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from vaoi_station.errors import DeviceError
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.rig.line.virtual_line import BoardPassage, VirtualLine

READY_TIMEOUT_S = 30.0
"""Longest wait until the station is ready for a board, and until it permits the board, s each. After it, the board
passes nevertheless."""
END_MARGIN_S = 1.0
"""Time to wait after the last pulse or barrier edge of a board, s, before its passage counts as ended."""


class BoardFeeder:
    """A thread, as a context manager, that lets boards pass. At the end of the context no more boards come.

    If the chip ends unexpectedly, the end of the context raises the thread's DeviceError.
    """

    def __init__(
        self,
        line: VirtualLine,
        boards: Sequence[RenderedBoard],
        interval_s: float,
        wait_ready: Callable[[float], bool] = lambda _: True,
        wait_permitted: Callable[[float], bool] = lambda _: True,
    ) -> None:
        """Prepare the feeder.

        Args:
            line: the virtual line, which lets a board pass.
            boards: the boards that pass, in order.
            interval_s: shortest time between the starts of two passages.
            wait_ready: called with a timeout in seconds; waits until the station is ready to record a board.
            wait_permitted: called with a timeout in seconds; holds the board back until the output "line ready" is on.
        """
        self._line, self._boards, self._interval_s, self._wait_ready = line, boards, interval_s, wait_ready
        self._wait_permitted = wait_permitted
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="feeder")
        self.passages: list[BoardPassage] = []
        self.finished = threading.Event()
        """Event that is set when all boards have passed, or when feeding has ended early."""
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
            # An exception that leaves a thread is only printed. So it is kept here, and __exit__ raises it.
            self._failure = error
        self.finished.set()

    def _feed(self) -> None:
        due_s = time.monotonic()
        for board in self._boards:
            if self._closing.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._wait_ready(READY_TIMEOUT_S)
            came_s = time.monotonic()
            permitted = self._wait_permitted(READY_TIMEOUT_S)
            held_s = time.monotonic() - came_s if permitted else None
            # This is counted from the time at which the station was ready, so that a slow station does not get two
            # boards at once.
            due_s = time.monotonic() + self._interval_s
            passage = self._line.start_passage(board)
            passage.held_s = held_s
            self.passages.append(passage)
            if self._closing.wait(board.duration_s + END_MARGIN_S):
                return

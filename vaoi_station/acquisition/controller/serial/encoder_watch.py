"""Watch of the encoder during a run whose rows follow the belt: without counts, no row is fired and no run ends."""

from __future__ import annotations

from vaoi_station.acquisition.controller.protocol.messages import TICK_S, Pacing, State, Status, Timing
from vaoi_station.errors import DeviceError

STILL_S = 5.0
"""Time without a count, while a board is in the barrier or its tail, after which this is reported."""
BACKWARDS_COUNTS = 20
"""Counts backwards that are reported: a belt at rest may shake by a few."""
_WRAP = 1 << 32


class EncoderWatch:
    """Evaluates the positions of successive status messages of one run."""

    def __init__(self) -> None:
        self._run: tuple[int, int] | None = None
        """Boot counter of the controller, and the number of its arming; None while no run is under way."""
        self._position = self._tick = 0
        self._reported = False

    def check(self, timing: Timing, status: Status) -> DeviceError | None:
        """Return an error, once per run, if the encoder stands still or counts backwards; otherwise None."""
        if timing.pacing != Pacing.DISTANCE or status.state != State.RUNNING:
            self._run = None
            return None
        if self._run != (status.boots, status.run):
            self._run, self._reported = (status.boots, status.run), False
            self._position, self._tick = status.position, status.tick
            return None
        moved = (status.position - self._position + _WRAP // 2) % _WRAP - _WRAP // 2
        if moved > 0:
            self._position, self._tick = status.position, status.tick
        still_s = (status.tick - self._tick) % _WRAP * TICK_S
        if self._reported or (moved > -BACKWARDS_COUNTS and still_s < STILL_S):
            return None
        self._reported = True
        if moved <= -BACKWARDS_COUNTS:
            return DeviceError(
                f"The encoder has counted {-moved} backwards while a board passes: no row is fired.",
                action="Exchange its channels A and B (hw/wiring.md), or check the direction of the belt.",
                code="encoder-backwards",
            )
        return DeviceError(
            f"The encoder has not counted for {still_s:.1f} s while a board is in the barrier: no row is fired.",
            action="Check that the belt runs, then the encoder and its cable (vaoi doctor); disarm to end the run.",
            code="encoder-silent",
        )

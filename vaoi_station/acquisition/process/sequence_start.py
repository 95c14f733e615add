"""Let the sequencers of the cameras begin anew between two boards, and never while pulses may be fired.

Every pulse leads a sequencer to its next set. To begin anew, the acquisition of a camera is stopped for some
milliseconds, so that a pulse meanwhile is not answered, and one before has already been exposed with the wrong set.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence

from vaoi_station.acquisition.cameras.interface import CameraDevice
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    PulseFired,
    RunEnded,
    TriggerPlan,
)

_log = logging.getLogger(__name__)

MARGIN_S = 0.005
"""Time, s, between the end of a rewind, which is expected to last as long as the one before, and the first pulse."""


class SequenceStart:
    """Follows the events of the controller, and rewinds each camera once after the pulses of a board."""

    def __init__(self, cameras: Sequence[CameraDevice], host_s: Callable[[float], float]) -> None:
        """Begin with sequences that are at their first set.

        Args:
            cameras: the cameras; those without a sequencer ignore a rewind.
            host_s: maps the controller's times to the host's clock.
        """
        self._cameras, self._host_s = cameras, host_s
        self._advanced: set[int] = set()
        """Cameras whose sequencer is not at its first set, because pulses were fired."""
        self._took_s = [0.0] * len(cameras)
        """Duration of the latest rewind of each camera."""
        self._fires_from_s = math.inf
        """Host time from which on pulses may be fired; infinite while no board is in the barrier."""

    @property
    def board_comes(self) -> bool:
        """Whether a board is in the barrier, before its first pulse."""
        return math.isfinite(self._fires_from_s)

    def follow(self, event: ControllerEvent, plan: TriggerPlan | None) -> None:
        """Note what an event says of coming pulses. Events of a run that was given up are noted too."""
        if isinstance(event, BarrierBlocked):
            delay_s = plan.shortest_start_s if plan is not None else 0.0
            self._fires_from_s = self._host_s(event.time_s) + delay_s
        elif isinstance(event, PulseFired):
            if self._advanced and self._fires_from_s > -math.inf:
                numbers = ", ".join(map(str, sorted(self._advanced)))
                _log.warning("pulses came before the sequence of exposures had begun anew in camera %s", numbers)
            self._fires_from_s = -math.inf
            self._advanced = set(range(len(self._cameras)))
        elif isinstance(event, RunEnded):
            self._fires_from_s = math.inf

    def end_pulses(self) -> None:
        """Note that no pulse is fired any more, because the controller is disarmed."""
        self._fires_from_s = math.inf

    def is_due(self, now_s: float) -> bool:
        """Return whether a sequence has to begin anew, and no pulse may be fired yet."""
        return bool(self._advanced) and now_s < self._fires_from_s

    def rewind(self, now_s: float) -> None:
        """Rewind the cameras whose sequencers have advanced, as far as there is time before the next pulse."""
        began_s = time.monotonic()
        for number in sorted(self._advanced):
            at_s = now_s + time.monotonic() - began_s
            # A camera that does not answer delays this for seconds. Those after it would be stopped during a pulse.
            if at_s + self._took_s[number] + MARGIN_S < self._fires_from_s:
                self._cameras[number].rewind()
                self._took_s[number] = now_s + time.monotonic() - began_s - at_s
                self._advanced.discard(number)

    def rewind_all(self) -> None:
        """Rewind all cameras, while the controller is disarmed."""
        self._fires_from_s = math.inf
        self._advanced = set(range(len(self._cameras)))
        self.rewind(0.0)

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
from vaoi_station.acquisition.process.messages import Report
from vaoi_station.acquisition.process.run_reports import trouble_report
from vaoi_station.errors import DeviceError

_log = logging.getLogger(__name__)

MARGIN_S = 0.005
"""Time, s, between the end of a rewind, which is expected to last as long as the one before, and the first pulse."""


class SequenceStart:
    """Follows the events of the controller, and rewinds each camera once after the pulses of a board."""

    def __init__(
        self, cameras: Sequence[CameraDevice], host_s: Callable[[float], float], send: Callable[[Report], None]
    ) -> None:
        """Begin with sequences that are at their first set.

        Args:
            cameras: the cameras; those without a sequencer ignore a rewind.
            host_s: maps the controller's times to the host's clock.
            send: sends a report to the station.
        """
        self._cameras, self._host_s, self._send = cameras, host_s, send
        self._advanced: set[int] = set()
        """Cameras whose sequencer is not at its first set, because pulses were fired."""
        self._took_s = [0.0] * len(cameras)
        """Duration, s, that is expected of the next rewind of each camera: that of the latest one, or less."""
        self._late: set[int] = set()
        """Cameras that are reported as late, and have not begun their sequence anew in time since then."""
        self._delay_s = 0.0
        """Time, s, from the latest edge of a board to the first pulse that it may bring."""
        self._fires_from_s = math.inf
        """Host time from which on pulses may be fired; infinite while no board is in the barrier."""

    @property
    def board_comes(self) -> bool:
        """Whether a board is in the barrier, before its first pulse."""
        return math.isfinite(self._fires_from_s)

    def follow(self, event: ControllerEvent, plan: TriggerPlan | None) -> None:
        """Note what an event says of coming pulses. Events of a run that was given up are noted too."""
        if isinstance(event, BarrierBlocked):
            self._delay_s = plan.shortest_start_s if plan is not None else 0.0
            self._fires_from_s = self._host_s(event.time_s) + self._delay_s
        elif isinstance(event, PulseFired):
            if self._advanced and self._fires_from_s > -math.inf:
                self._report_late(self._advanced)
                self._expect_less()
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
                ended_s = now_s + time.monotonic() - began_s
                self._took_s[number] = ended_s - at_s
                self._advanced.discard(number)
                if ended_s < self._fires_from_s:
                    self._late.discard(number)
                else:
                    self._report_late({number})

    def rewind_all(self) -> None:
        """Rewind all cameras, while the controller is disarmed."""
        self._fires_from_s = math.inf
        self._advanced = set(range(len(self._cameras)))
        self.rewind(0.0)

    def forget(self, camera: int) -> None:
        """Expect nothing of the next rewind of a camera, because it was opened anew."""
        self._took_s[camera] = 0.0

    def _expect_less(self) -> None:
        """Let cameras that were left out because they were slow be tried again after some boards.

        One slow reply, of a busy network, would otherwise leave a camera out for ever: only a rewind is measured.
        """
        for number in self._advanced:
            if self._took_s[number] > self._delay_s / 2:
                self._took_s[number] /= 2

    def _report_late(self, cameras: set[int]) -> None:
        """Log that cameras begin a board with the wrong exposure; report it once until they are in time again."""
        numbers = ", ".join(map(str, sorted(cameras)))
        _log.warning("pulses came before the sequence of exposures had begun anew in camera %s", numbers)
        if cameras <= self._late:
            return
        self._late |= cameras
        longest_s = max(self._took_s[number] for number in cameras)
        what = (
            f"camera {numbers}: its sequence of exposures did not begin anew before the first pulse of a board, whose "
            f"first frames may have the wrong exposure. Beginning anew took up to {longest_s:.2f} s; the first pulse "
            f"may come {self._delay_s:.2f} s after the edge of a board."
        )
        action = "Check its cable and the load of its network; if it comes again, use a longer start delay."
        self._send(trouble_report(DeviceError(what, action=action, code="sequence-late")))

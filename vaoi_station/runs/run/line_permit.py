"""Permits for the output "line ready": one number for each board, renewed while the next board may come."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.process.messages import PermitBoard
from vaoi_station.runs.states.schemas import Reason

VALID_S = 1.0
"""Time for which a permit is valid after it was given or renewed, s. At the latest then, the output falls."""
RENEW_S = 0.25
"""Shortest time between two renewals, s."""
_LARGEST = 0xFFFF


class LinePermit:
    """Gives and withdraws permits, and publishes why boards are held back. Used by the coordinator's thread only."""

    def __init__(self, send: Callable[[PermitBoard], None] | None, publish: Callable[..., Any]) -> None:
        """Begin without a permit.

        Args:
            send: sends a command to the acquisition process; None if the output is not used.
            publish: function that writes an event, with the signature of `EventLog.add`.
        """
        self._send, self._publish = send, publish
        self._number = 0
        self._ready = False
        self._reports = 0
        self._renewed_s = float("-inf")
        self._troubles: tuple[str, ...] = ()

    def update(self, held: Sequence[Reason], reports: int, now_s: float) -> None:
        """Give, renew or withdraw the permit.

        Args:
            held: why the next board must wait; empty if it may come.
            reports: count of boards without a run so far. If it has changed, a board may have used the permit.
            now_s: the present time by time.monotonic().
        """
        ready = not held
        fresh = ready and (not self._ready or reports != self._reports)
        if fresh:
            # Another number for each board: the firmware ignores a permit that a board has used up.
            self._number = self._number % _LARGEST + 1
        if self._send is not None:
            if ready and (fresh or now_s - self._renewed_s >= RENEW_S):
                self._renewed_s = now_s
                self._send(PermitBoard(Permit(self._number, now_s + VALID_S)))
            elif self._ready and not ready:
                self._send(PermitBoard(None))
        self._ready, self._reports = ready, reports

    def publish(self, troubles: Sequence[Reason]) -> None:
        """Publish a change of what holds boards back on an armed line; `troubles` is empty if nothing is wrong."""
        codes = tuple(reason.code for reason in troubles)
        if codes == self._troubles:
            return
        self._troubles = codes
        if troubles:
            first = troubles[0]
            message = f"Boards are held back: {first.message}"
            self._publish("line", message, code="line-held", action=first.action)
        else:
            self._publish("line", "Boards are no longer held back.", code="line-free")

"""Switch the controller's output "line ready" high and low, so that its wiring can be measured during bring-up."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing

from vaoi_station.acquisition.controller.protocol.link import HEARTBEAT_S, Link
from vaoi_station.acquisition.controller.protocol.messages import PERMIT_TEST, Hold, Status, ready
from vaoi_station.acquisition.controller.protocol.refusals import check_ident, check_interlock
from vaoi_station.acquisition.controller.serial.exchange import Exchange
from vaoi_station.acquisition.controller.serial.port import Port, Waker
from vaoi_station.config import ControllerConfig
from vaoi_station.errors import DeviceError

TIMES = 3
"""How often the output goes high."""
LEVEL_S = 4.0
"""Time for which each level lasts, s: long enough for a multimeter."""


def toggle_line_output(
    settings: ControllerConfig, show: Callable[[str], None], times: int = TIMES, level_s: float = LEVEL_S
) -> None:
    """Switch the output high and low in turn; `show` receives what to expect at each level. It ends low.

    The firmware permits this only while no station has armed it. If this program ends, the firmware lowers the output
    by itself within a second.

    Raises:
        DeviceError: the controller does not reply, has no such output, is armed, or the output does not follow.
    """
    with closing(Waker()) as waker, closing(Port(settings.port, settings.baud, waker)) as port:
        exchange = Exchange(port, Link(), lambda _news, _heard_s: None, settings.port)
        ident = check_ident(exchange.identify())
        check_interlock(ident)
        try:
            for k in range(times):
                show(f"{k + 1} of {times}: line ready. A0 is at 5 V, the contact X4 is closed.")
                _hold(exchange, ident.ready_longest_ms, level_s)
                show(f"{k + 1} of {times}: line not ready. A0 is at 0 V, the contact X4 is open.")
                _hold(exchange, 0, level_s)
        finally:
            exchange.link.drop_requests()
            exchange.request(ready(PERMIT_TEST, 0))


def _hold(exchange: Exchange, hold_ms: int, level_s: float) -> None:
    """Keep the output high by renewing the test, or low if `hold_ms` is 0."""
    end_s = time.monotonic() + level_s
    while (now_s := time.monotonic()) < end_s:
        status = Status.unpack(exchange.request(ready(PERMIT_TEST, hold_ms)).payload)
        if bool(status.ready) != bool(hold_ms):
            blocked = status.hold == Hold.BARRIER or status.blocked
            raise DeviceError(
                f"The output 'line ready' stays {'low' if hold_ms else 'high'}"
                f"{': the light barrier is interrupted' if blocked else ''}.",
                action="Clear the light barrier." if blocked else "Check A0 for a short circuit.",
                code="interlock-stuck",
            )
        while time.monotonic() < min(now_s + HEARTBEAT_S, end_s):
            exchange.poll()

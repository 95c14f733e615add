"""A computer with a serial controller, to be stopped from outside: arms, and prints each event on a line.

A moment without news is a line as well.
"""

from __future__ import annotations

import sys
import time
from queue import Empty, SimpleQueue

from vaoi_station.acquisition.controller.interface import EventQueue, Permit, TriggerPlan
from vaoi_station.acquisition.controller.serial import SerialController
from vaoi_station.config import ControllerConfig


def main(port: str) -> None:
    controller = SerialController(ControllerConfig(backend="serial", port=port, interlock="on"))
    events: EventQueue = SimpleQueue()
    controller.start(events)
    controller.arm(TriggerPlan(start_delay_s=0.03, period_s=0.02, tail_s=0.03, max_rows=1000, debounce_s=0.005))
    controller.permit_board(Permit(1, time.monotonic() + 1e6))
    print("armed", flush=True)
    while True:
        try:
            print(events.get(timeout=0.1), flush=True)
        except Empty:
            print("nothing new", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])

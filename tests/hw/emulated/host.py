"""The station's end of the line: a controller on the emulated chip, and its events."""

from __future__ import annotations

from queue import SimpleQueue
from typing import TypeVar

from tests.hw.emulated.paced import HZ, PATIENCE_S, PacedChip
from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import EventQueue, PulseFired, RunEnded, TriggerPlan
from vaoi_station.acquisition.controller.serial import SerialController
from vaoi_station.config import ControllerConfig, LightConfig
from vaoi_station.errors import DeviceError

PLAN = TriggerPlan(start_delay_s=0.03, period_s=0.02, tail_s=0.03, max_rows=20, debounce_s=0.005)
LIGHTS = {"top": LightConfig(channels=(0, 1), on_us=300.0), "low": LightConfig(channels=(2,), on_us=200.0)}

E = TypeVar("E")


class Host:
    """A controller and its events, in order; its clock is modelled as the acquisition process does."""

    def __init__(self, chip: PacedChip, *, contacts: bool = False) -> None:
        self.chip = chip
        self.clock = ClockModel("controller")
        self.seen: list[object] = []
        self._events: EventQueue = SimpleQueue()
        self.controller = SerialController(
            ControllerConfig(
                backend="serial",
                port=str(chip.link),
                lights=LIGHTS,
                order=("top", "low", "top"),
                interlock="on" if contacts else "off",
            ),
            contacts=contacts,
        )
        self.controller.start(self._events)
        for _ in range(8):
            self.clock.add(self.controller.read_clock())

    def next(self, kind: type[E]) -> E:
        """Return the next item of this kind; all others before it are kept in `seen`."""
        while True:
            item = self._events.get(timeout=PATIENCE_S)
            self.seen.append(item)
            if isinstance(item, ClockReading):
                self.clock.add(item)
            if isinstance(item, kind):
                return item

    def run(self, ms: float = 100) -> list[PulseFired]:
        """Let a board pass and return its pulses when its run has ended."""
        self.seen.clear()
        self.chip.board(ms)
        assert self.next(RunEnded).reason == "clear"
        return self.pulses()

    def pulses(self) -> list[PulseFired]:
        return [item for item in self.seen if isinstance(item, PulseFired)]

    def fault_codes(self) -> set[str]:
        """Return the codes of the reported faults."""
        return {item.error.code for item in self.seen if isinstance(item, DeviceFault)}

    def wait_ready(self) -> None:
        """Wait until the controller accepts requests again."""
        begun = self.chip.do("pin PD2 0")
        while True:
            try:
                self.clock.add(self.controller.read_clock())
                return
            except DeviceError:
                assert self.chip.do("pin PD2 0") - begun < PATIENCE_S * HZ

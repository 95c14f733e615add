"""A host at the terminal of the chip: it configures the firmware for a scenario and arms it, no more."""

from __future__ import annotations

import time
from pathlib import Path
from types import TracebackType

import serial

from vaoi_station.acquisition.controller.protocol import (
    Link,
    Pacing,
    Refused,
    Replied,
    Request,
    Step,
    Timing,
    arm,
    config_crc,
    configuration,
)
from vaoi_station.simulation import Scenario

PATIENCE_S = 20.0


def ticks(seconds: float) -> int:
    return round(seconds * 2e6)


class Host:
    """A context manager; `turn` lets it beat its heart."""

    def __init__(self, terminal: Path) -> None:
        self._port = serial.Serial(str(terminal), 250_000, timeout=0.002)
        self._link = Link(heartbeat=True)

    def turn(self) -> list[object]:
        now_s = time.monotonic()
        if data := self._link.outgoing(now_s):
            self._port.write(data)
        data = self._port.read(256)
        return list(self._link.receive(data, time.monotonic())) if data else []

    def ask(self, request: Request) -> None:
        self._link.request(request)
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            for news in self.turn():
                if isinstance(news, Replied) and news.request == request:
                    return
                assert not isinstance(news, Refused), news
        raise AssertionError(f"no answer to {request}")

    def arm(self, scenario: Scenario, steps: tuple[Step, ...]) -> None:
        line = scenario.line
        timing = Timing(
            pacing=Pacing.TIME,
            steps=len(steps),
            max_rows=50,
            start_delay=ticks(line.start_delay_s),
            period=ticks(line.period_s),
            tail=ticks(line.tail_s),
            min_period=ticks(line.period_s),
            debounce=ticks(line.debounce_s),
            min_gap=0,
            trigger_width=ticks(1e-4),
        )
        for request in [*configuration(timing, steps), arm(1, config_crc(timing, steps))]:
            self.ask(request)

    def wait(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.turn()

    def __enter__(self) -> Host:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._port.close()

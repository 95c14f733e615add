"""The host's end of the line on simulated time: `Link` talking to the emulated chip."""

from __future__ import annotations

from collections.abc import Sequence

from tests.hw.emulated.chip import Chip
from vaoi_station.acquisition.controller.protocol import (
    Event,
    EventReceived,
    Kind,
    Link,
    Nak,
    Notification,
    Pacing,
    Refused,
    Replied,
    Request,
    Restarted,
    Status,
    Step,
    Timing,
    Type,
    arm,
    config_crc,
    configuration,
)

HZ = 16_000_000


def us(value: float) -> int:
    """Ticks of a time in µs."""
    return round(2 * value)


def ms(value: float) -> int:
    """Ticks of a time in ms."""
    return us(1000 * value)


TIMING = Timing(
    pacing=Pacing.TIME,
    steps=3,
    max_rows=50,
    start_delay=ms(20),
    period=ms(20),
    tail=ms(30),
    min_period=ms(20),
    debounce=ms(2),
    min_gap=ms(10),
    trigger_width=us(100),
)
STEPS = (Step(0b0001, us(250)), Step(0b0110, us(61.5)), Step(0b1000, us(500)))


class Line:
    """Turns of 1 ms: the link's bytes are sent, the chip runs, and its replies go to the link."""

    def __init__(self, chip: Chip, *, beating: bool = True) -> None:
        self.chip = chip
        self.link = Link(heartbeat=beating)
        self.news: list[Notification] = []

    @property
    def now_s(self) -> float:
        return self.chip.cycle / HZ

    def turn(self, extra: bytes = b"") -> list[Notification]:
        data = self.link.outgoing(self.now_s) + extra
        if data:
            self.chip.do(f"send {data.hex()}")
        self.chip.run_ms(1)
        news = self.link.receive(self.chip.take(), self.now_s)
        self.news += news
        return news

    def run(self, turns: int, extra: bytes = b"") -> None:
        for _ in range(turns):
            self.turn(extra)

    def request(self, request: Request) -> bytes | Nak:
        """Send a request; return the payload of the reply, or the refusal."""
        self.link.request(request)
        for _ in range(2000):
            for item in self.turn():
                if isinstance(item, Replied | Refused) and item.request == request:
                    return item.payload if isinstance(item, Replied) else item.nak
        raise AssertionError(f"no answer to {request}")

    def arm(self, timing: Timing = TIMING, steps: Sequence[Step] = STEPS, run: int = 7) -> None:
        for request in [*configuration(timing, steps), arm(run, config_crc(timing, steps))]:
            answer = self.request(request)
            assert isinstance(answer, bytes), answer

    def barrier(self, blocked: bool) -> int:
        """Change the barrier now; return the cycle of the edge."""
        self.chip.do(f"pin PB0 {int(blocked)}")
        return self.chip.cycle

    def passage(self, ms: int, extra: bytes = b"") -> tuple[int, int]:
        """Let a board pass; return the cycles of its edges."""
        edge = self.barrier(True)
        self.run(ms, extra)
        return edge, self.barrier(False)

    def events(self, kind: Kind | None = None) -> list[Event]:
        events = [item.event for item in self.news if isinstance(item, EventReceived)]
        return [event for event in events if kind is None or event.kind == kind]

    def restarts(self) -> list[int]:
        return [item.boots for item in self.news if isinstance(item, Restarted)]

    def status(self) -> Status:
        """Read the present status."""
        self.request(Request(Type.STATUS))
        assert self.link.status is not None
        return self.link.status

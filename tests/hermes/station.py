"""A station without a line: the real connections to neighbours, with runs and orders that a test makes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from tests.push.event_list import EventList
from vaoi_station.config import read_config
from vaoi_station.hermes.lane import Transfer
from vaoi_station.hermes.service import HermesService
from vaoi_station.line_config import Hermes
from vaoi_station.model import Reason
from vaoi_station.runs.run.order_queue import LineBoard

WAIT_S = 30.0
EXAMPLE = Path(__file__).parents[2] / "deploy" / "station.toml"


class GivenOrders:
    """Orders for every board: first in, first out; `held` holds the next board back."""

    def __init__(self) -> None:
        self.held: tuple[Reason, ...] = ()
        self.announced: LineBoard | None = None
        self.gap: list[LineBoard] = []
        self.of_run: dict[str, LineBoard] = {}
        self.bad_by_contacts: set[str] = set()
        self.calls: list[str] = []

    def by_messages(self, on: bool) -> None:
        assert on

    def announce(self, lane: int, board: LineBoard) -> tuple[Reason, ...]:
        self.announced = board
        self.calls.append(f"announce {board.board_id}")
        return self.held

    def withdrawn(self, lane: int) -> tuple[Reason, ...]:
        self.announced = None
        self.calls.append("withdrawn")
        return self.held

    def started(self, lane: int) -> tuple[Reason, ...]:
        assert self.announced is not None
        self.calls.append("started")
        return self.held

    def finished(self, lane: int, transfer: Transfer) -> tuple[Reason, ...]:
        assert self.announced is not None
        if transfer == "complete":
            self.gap.append(self.announced)
        self.announced = None
        self.calls.append(f"finished {transfer}")
        return self.held

    def may_accept(self, lane: int) -> tuple[Reason, ...]:
        return self.held

    def board_of_run(self, run: str) -> LineBoard | None:
        if run not in self.of_run and self.gap:
            self.of_run[run] = self.gap.pop(0)
        return self.of_run.get(run)

    def came_failed(self, run: str) -> bool:
        return run in self.bad_by_contacts


class PlayedStation:
    """The connections of a station, and what a test lets happen in it."""

    def __init__(self, data: Path, **table: Any) -> None:
        self.config = Hermes(**table)
        self.events, self.orders, self._runs = EventList(), GivenOrders(), 0
        whole = read_config(EXAMPLE).model_copy(update={"hermes": self.config, "data": data})
        self.service = HermesService(self.config, whole, cast("Any", self.events))

    def film(self) -> str:
        """Let a board pass the cameras, and its run end."""
        self._runs += 1
        run = f"20260101-{self._runs:06d}"
        self.events.add("run", "A board is being filmed.", state="filming", run=run)
        self.events.add("run", "Done.", state="ready", run=run)
        return run

    def connect(self, port: int) -> socket.socket:
        """Connect to the station as soon as it listens."""
        made: list[socket.socket] = []

        def listens() -> bool:
            with suppress(ConnectionRefusedError):
                made.append(socket.create_connection(("127.0.0.1", port), WAIT_S))
            return bool(made)

        wait_for(listens)
        return made[0]

    @contextmanager
    def running(self) -> Iterator[PlayedStation]:
        with self.service.running(lambda _: None, self.orders):
            yield self


def wait_for(holds: Callable[[], bool]) -> None:
    """Wait until the thread of the connections has come so far."""
    pause = threading.Event()
    for _ in range(3000):
        if holds():
            return
        pause.wait(0.01)
    raise AssertionError("it did not come so far")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])

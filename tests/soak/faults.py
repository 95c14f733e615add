"""The faults of a soak. Each is injected, lasts for some time, and is undone; its seed decides when and which."""

from __future__ import annotations

import os
import random
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from tests.soak.service import Service
from tests.soak.small_disk import SmallDisk

STREAMS, READERS, HALF_SENT = 24, 12, 40
"""Event streams, readers that do not read, and half-sent requests at a time."""


@dataclass(frozen=True)
class Target:
    """What faults act on: the station, its disk, and the newest document about its state."""

    service: Service
    disk: SmallDisk | None
    station: Callable[[], dict[str, Any]]
    newest_run: Callable[[], str | None]

    def pid(self, name: str) -> int | None:
        """Return the process id of a child of the station; None while it has none."""
        found = (p["pid"] for p in self.station()["processes"] if p["name"] == name)
        return next(found, None)


@contextmanager
def _signalled(pid: int | None, begin: signal.Signals, end: signal.Signals | None = None) -> Iterator[None]:
    # A process that has ended meanwhile is what the fault is about.
    with suppress(ProcessLookupError):
        if pid:
            os.kill(pid, begin)
    yield
    with suppress(ProcessLookupError):
        if pid and end:
            os.kill(pid, end)


def _worker(target: Target, chance: random.Random) -> int | None:
    return target.pid(chance.choice(["worker 0", "worker 1"]))


def kill_worker(target: Target, chance: random.Random) -> Any:
    """Kill a worker."""
    return _signalled(_worker(target, chance), signal.SIGKILL)


def hang_worker(target: Target, chance: random.Random) -> Any:
    """Stop a worker for the time of the fault."""
    return _signalled(_worker(target, chance), signal.SIGSTOP, signal.SIGCONT)


def kill_fork_server(target: Target, chance: random.Random) -> Any:
    """Kill the fork server."""
    return _signalled(target.pid("fork server"), signal.SIGKILL)


def hang_fork_server(target: Target, chance: random.Random) -> Any:
    """Stop the fork server for the time of the fault."""
    return _signalled(target.pid("fork server"), signal.SIGSTOP, signal.SIGCONT)


def kill_acquisition(target: Target, chance: random.Random) -> Any:
    """Kill the acquisition process."""
    return _signalled(target.pid("acquisition"), signal.SIGKILL)


def hang_acquisition(target: Target, chance: random.Random) -> Any:
    """Stop the acquisition process for the time of the fault."""
    return _signalled(target.pid("acquisition"), signal.SIGSTOP, signal.SIGCONT)


@contextmanager
def kill_station(target: Target, chance: random.Random) -> Iterator[None]:
    """Kill the station's main process."""
    with suppress(ProcessLookupError):
        target.service.kill()
    yield


def hang_station(target: Target, chance: random.Random) -> Any:
    """Stop the station's main process for the time of the fault."""
    return _signalled(target.service.pid, signal.SIGSTOP, signal.SIGCONT)


@contextmanager
def full_disk(target: Target, chance: random.Random) -> Iterator[None]:
    """Leave no free page on the data disk."""
    assert target.disk is not None
    target.disk.fill()
    try:
        yield
    finally:
        target.disk.make_room()


@contextmanager
def _connections(target: Target, count: int, request: str) -> Iterator[None]:
    with ExitStack() as opened:
        for _ in range(count):
            with suppress(OSError):
                connection = opened.enter_context(socket.create_connection(("127.0.0.1", target.service.port), 5))
                connection.sendall(request.encode())
        yield


def _get(path: str) -> str:
    return f"GET /api/v1/{path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


def silent_readers(target: Target, chance: random.Random) -> Any:
    """Request raw frames and long lists, and do not read the answers."""
    run = target.newest_run()
    path = f"runs/{run}/frames/0/0?format=raw" if run and chance.random() < 0.5 else "runs?limit=500"
    return _connections(target, READERS, _get(path) * 20)


def many_streams(target: Target, chance: random.Random) -> Any:
    """Open event streams from the first event on, and read none of them."""
    return _connections(target, STREAMS, _get("events?after=0"))


def half_sent(target: Target, chance: random.Random) -> Any:
    """Begin requests and send no more."""
    return _connections(target, HALF_SENT, "POST /api/v1/station/arm HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Le")


@dataclass(frozen=True)
class Fault:
    """A kind of fault: how it is injected, and for how long (s, from … to)."""

    inject: Callable[[Target, random.Random], Any]
    lasts_s: tuple[float, float] = (0.0, 0.0)
    weight: float = 1.0


FAULTS = {
    "worker killed": Fault(kill_worker, weight=3),
    "worker hangs": Fault(hang_worker, (2, 12), 2),
    "fork server killed": Fault(kill_fork_server),
    "fork server hangs": Fault(hang_fork_server, (2, 15)),
    "acquisition killed": Fault(kill_acquisition, weight=2),
    "acquisition hangs": Fault(hang_acquisition, (1, 15)),
    "station killed": Fault(kill_station, weight=1),
    "station hangs": Fault(hang_station, (1, 6)),
    "disk full": Fault(full_disk, (3, 10), 2),
    "readers do not read": Fault(silent_readers, (5, 15), 2),
    "many event streams": Fault(many_streams, (5, 15), 2),
    "half-sent requests": Fault(half_sent, (5, 15), 2),
}
"""All faults. A camera that is lost while a board passes is a part of the recordings (`tests/soak/line_files.py`)."""
NAMES = tuple(FAULTS)


def draw(chance: random.Random, names: tuple[str, ...]) -> tuple[str, float]:
    """Return the name of the next fault and its duration, s."""
    [name] = chance.choices(names, [FAULTS[n].weight for n in names])
    return name, chance.uniform(*FAULTS[name].lasts_s)

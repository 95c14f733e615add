"""What stands in for cameras and network cards: a process of its own that fills slots of the ring from a film.

As they do it by themselves in a real station, its time is accounted apart from the station's.
"""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.benchmarks.film import Film
from vaoi_station.runs.host.process_setup import set_up_process


@dataclass(frozen=True)
class Order:
    """Fill this slot with the film's frame."""

    camera: int
    row: int
    slot: int


@dataclass(frozen=True)
class Sender:
    """The running process; what the acquisition process needs to talk to it is `connection`."""

    pid: int
    connection: Connection[Any, Any]


@contextlib.contextmanager
def sender(film: Film) -> Iterator[Sender]:
    """Starts the process; it ends when its pipe does."""
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=send, args=(film, there), name="vaoi-bench-sender", daemon=True)
    process.start()
    there.close()
    assert process.pid is not None
    try:
        yield Sender(process.pid, here)
    finally:
        here.close()
        process.join()
        process.close()


def send(film: Film, connection: Connection[Any, Any]) -> None:
    """Fill slots until the pipe ends: first comes the ring's path, then orders; each is sent back when it is done."""
    set_up_process(one_thread=True)
    frames = film.map()
    with (
        contextlib.suppress(EOFError, ConnectionResetError, BrokenPipeError),
        connection,
        Ring.attach(Path(connection.recv()), writable=True) as ring,
    ):
        while True:
            order: Order = connection.recv()
            ring.memory(order.slot)[:] = frames[order.row, order.camera].reshape(-1)
            connection.send(order)

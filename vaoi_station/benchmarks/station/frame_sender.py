"""The sender process, which replaces cameras and network cards: it copies prerendered frames into slots of the ring.

Real frames arrive by DMA and receive threads. A separate process keeps the time of this copying out of the CPU time
of the station.
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
from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.runs.host.process_setup import set_up_process


@dataclass(frozen=True)
class FillRequest:
    """A request to copy one prerendered frame into a slot. The sender returns the request when the slot is filled."""

    camera: int
    row: int
    slot: int


@dataclass(frozen=True)
class FrameSender:
    """The running sender process and the station's end of its pipe."""

    pid: int
    connection: Connection[Any, Any]


@contextlib.contextmanager
def run_frame_sender(run: PrerenderedRun) -> Iterator[FrameSender]:
    """Run the sender process inside a `with` block. The end of the block closes the pipe, and the process ends."""
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=fill_slots, args=(run, there), name="vaoi-bench-sender", daemon=True)
    process.start()
    # With the other end open here, closing the pipe would never reach the process as an end of file.
    there.close()
    assert process.pid is not None
    try:
        yield FrameSender(process.pid, here)
    finally:
        here.close()
        process.join()
        process.close()


def fill_slots(run: PrerenderedRun, connection: Connection[Any, Any]) -> None:
    """Fill slots until the pipe is closed: receive the path of the ring, then requests; send each back when done."""
    set_up_process(one_thread=True)
    frames = run.map()
    with (
        contextlib.suppress(EOFError, ConnectionResetError, BrokenPipeError),
        connection,
        Ring.attach(Path(connection.recv()), writable=True) as ring,
    ):
        while True:
            request: FillRequest = connection.recv()
            ring.memory(request.slot)[:] = frames[request.row, request.camera].reshape(-1)
            # Sent only after the copy: the acquisition process takes the returned request as the arrival of the frame.
            connection.send(request)

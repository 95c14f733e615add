"""Callers of the REST interface in a process of their own, as tester software is: pictures one by one, or a batch."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import threading
import time
from collections.abc import Iterator, Sequence
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from typing import Any, NamedTuple

from vaoi_station.errors import DeviceError

REPLY_LIMIT_S = 60.0
"""Longest wait for bytes of a reply."""
BATCH_LIMIT_S = 120.0
"""Time after which a batch is no longer read; it is then incomplete."""
_TAIL = 2000
_READ = 1 << 20


class Fetched(NamedTuple):
    """One reply that a caller received, such as a picture."""

    path: str
    sent_s: float
    """Time of the request by time.monotonic(), which all processes share."""
    ms: float
    """Time from the request to the last byte of the reply, with the pauses that the station asked for."""


class ReadBatch(NamedTuple):
    """One batch of pictures that was read to its end."""

    first_byte_ms: float
    total_s: float
    mbytes: float
    complete: bool


@contextlib.contextmanager
def callers(port: int, paths: Sequence[str], count: int) -> Iterator[list[Fetched]]:
    """Let callers fetch pictures again and again inside a `with` block, each over one connection that is kept.

    Args:
        port: port of the station on this machine.
        paths: addresses of the pictures; every caller begins with another one.
        count: number of callers, as threads of one process.

    The list that is yielded is filled at the end of the block. Raises DeviceError if a request was refused.
    """
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe(duplex=False)
    stop, found = spawn.Event(), list[Fetched]()
    process = spawn.Process(
        target=_fetch, args=(port, paths, count, stop, there), name="vaoi-bench-caller", daemon=True
    )
    process.start()
    there.close()
    try:
        here.recv()  # the process has loaded
        yield found
    finally:
        stop.set()
        reply: str | list[tuple[str, float, float]] = "its process ended without a report."
        with contextlib.suppress(EOFError):
            # Each thread ends with its reply, which takes at most the limit of a connection.
            if here.poll(2 * REPLY_LIMIT_S):
                reply = here.recv()
        process.kill()
        process.join()
    if isinstance(reply, str):
        raise DeviceError(f"A caller of the benchmark failed: {reply}")
    found.extend(Fetched(*fetched) for fetched in reply)


def read_batch(port: int, path: str) -> ReadBatch:
    """Read a batch of pictures in a new process, and forget its bytes."""
    spawn = multiprocessing.get_context("spawn")
    with spawn.Pool(1) as pool:
        return ReadBatch(*pool.apply(_read, (port, path)))


def _fetch(port: int, paths: Sequence[str], count: int, stop: Event, reply: Connection[Any, Any]) -> None:
    found, refused = list[tuple[str, float, float]](), list[str]()

    def call(first: int) -> None:
        connection = HTTPConnection("127.0.0.1", port, timeout=REPLY_LIMIT_S)
        for path in itertools.islice(itertools.cycle(paths), first, None):
            if stop.is_set() or refused:
                break
            began_s = time.monotonic()
            try:
                status, content = _get(connection, path, began_s + REPLY_LIMIT_S, stop)
            except (OSError, HTTPException) as error:
                refused.append(f"{path}: {error!r}")
                break
            if status == HTTPStatus.OK:
                found.append((path, began_s, (time.monotonic() - began_s) * 1e3))
            elif status != HTTPStatus.SERVICE_UNAVAILABLE or not stop.is_set():
                refused.append(f"{path}: {content[:200]!r}")
        connection.close()

    reply.send(None)
    threads = [threading.Thread(target=call, args=(len(paths) * k // count,)) for k in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    reply.send(refused[0] if refused else found)


def _get(connection: HTTPConnection, path: str, until_s: float, stop: Event) -> tuple[int, bytes]:
    """Fetch a picture; while the station is busy, pause as it asks and try again, as clients do."""
    while True:
        connection.request("GET", path)
        answer = connection.getresponse()
        content = answer.read()
        pause_s = float(answer.headers.get("Retry-After", 0))
        busy = answer.status == HTTPStatus.SERVICE_UNAVAILABLE and pause_s > 0
        if not busy or time.monotonic() + pause_s > until_s or stop.wait(pause_s):
            return answer.status, content


def _read(port: int, path: str) -> tuple[float, float, float, bool]:
    connection = HTTPConnection("127.0.0.1", port, timeout=REPLY_LIMIT_S)
    size, tail, first_s = 0, b"", 0.0
    began_s = time.monotonic()
    connection.request("GET", path)
    answer = connection.getresponse()
    # One piece of the answer at a time: `readinto` would return only when its memory is full.
    while (piece := answer.read1(_READ)) and time.monotonic() < began_s + BATCH_LIMIT_S:
        first_s = first_s or time.monotonic()
        size += len(piece)
        tail = (tail + piece)[-_TAIL:]
    ended_s = time.monotonic()
    connection.close()
    return (first_s - began_s) * 1e3, ended_s - began_s, size / 1e6, b'"complete":true' in tail

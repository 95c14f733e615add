"""Messages between the station and the fork server: one datagram each, with the file descriptors that belong to it.

The numbers of datagrams and descriptors are small, so neither side ever waits for room in the socket.
"""

from __future__ import annotations

import os
import pickle
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

_LONGEST_BYTES = 1 << 16
"""Longest message; it has a path and a few numbers."""
_MOST_DESCRIPTORS = 1
"""Largest number of file descriptors that belong to one message."""


@dataclass(frozen=True)
class Fork:
    """Ask for a worker. The worker's end of its pipe belongs to the message."""

    index: int
    ring: str
    """Path of the ring."""


@dataclass(frozen=True)
class Ping:
    """Ask the fork server to reply with `ServerReady`, as a check of its liveness."""


@dataclass(frozen=True)
class ServerStarting:
    """Report how far the warm-up of the fork server is; sent once a second until `ServerReady`."""

    compiled: int
    """Number of inner loops that are compiled or were loaded."""
    of: int


@dataclass(frozen=True)
class ServerReady:
    """Report that the fork server can fork; sent after its warm-up, and in reply to each `Ping`."""


@dataclass(frozen=True)
class Forked:
    """Report that a worker runs. A pidfd of its process belongs to the message."""

    index: int
    pid: int


@dataclass(frozen=True)
class NotForked:
    """Report that a worker could not be started, and why."""

    index: int
    why: str


@dataclass(frozen=True)
class WorkerEnded:
    """Report the exit code of a worker that has ended; negative for the number of a signal."""

    pid: int
    code: int


def pair() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a new socket for these messages."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def send(to: socket.socket, message: object, descriptors: Sequence[int] = ()) -> None:
    """Send a message with copies of file descriptors.

    Raises:
        OSError: the other side has ended, or does not read.
    """
    socket.send_fds(to, [pickle.dumps(message)], list(descriptors))


def receive(source: socket.socket) -> tuple[Any, list[int]] | None:
    """Return the next message and its file descriptors, which belong to the caller; None if the other side has ended.

    A process that has no room for further file descriptors receives the message without them.

    Raises:
        BlockingIOError: there is no message, and the socket does not block.
    """
    try:
        data, descriptors, _, _ = socket.recv_fds(source, _LONGEST_BYTES, _MOST_DESCRIPTORS)
    except ConnectionResetError:
        return None
    for descriptor in descriptors:
        # `recv_fds` makes them inheritable: a program that is started meanwhile would keep them open.
        os.set_inheritable(descriptor, False)
    return (pickle.loads(data), descriptors) if data else None

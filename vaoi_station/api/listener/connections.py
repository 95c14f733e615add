"""The open connections, limited in total and for each address.

If a limit is reached, one connection is closed for a new one: the connection that its caller needs least. This is one
that has sent no complete request, one that is idle, or one whose caller does not read. So a caller that holds many
connections open without using them cannot exclude others.
"""

from __future__ import annotations

import math
import resource
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

MOST_CONNECTIONS = 256
MOST_PER_ADDRESS = 64
MOST_WAITING, MOST_WAITING_PER_ADDRESS, MOST_REFUSED = 512, 256, 64
"""Limits of the connections that wait for the place of another one."""


class Idleness(NamedTuple):
    """Measure of how little a connection is needed; the connection with the smallest value is closed first."""

    served: bool
    """Whether a request was answered on the connection.

    A program that keeps its connection open is closed later than a caller that has never sent a complete request."""
    since: float
    """Time since which the connection has done nothing, s on the clock of the event loop."""


class Connection(Protocol):
    """The properties of a connection that the table of connections uses."""

    address: str

    def idleness(self) -> Idleness | None:
        """Return how little the connection is needed; None while a request is under way."""
        ...

    def cut(self) -> None:
        """Close the connection at once, without sending the rest of a reply."""
        ...


@dataclass(frozen=True)
class ConnectionLimits:
    """Limits of the number of connections and of their times; times are in s."""

    total: int = MOST_CONNECTIONS
    per_address: int = MOST_PER_ADDRESS
    handshake_s: float = 5.0
    """Longest time for a TLS handshake."""
    head_s: float = 10.0
    """Longest time without a request under way, until the head of the next request has arrived.

    Unread bodies must also end within this time."""
    stall_s: float = 10.0
    """Longest time during which a caller reads nothing of its reply."""
    answer_s: float = 120.0
    """Longest total time for which one reply waits for its reader; event streams have no such limit."""
    closing_s: float = 5.0
    """Time in which the rest of a reply must be read after the station has closed the connection."""
    young_s: float = 0.25
    """Time for which a connection without a reply yet keeps its place: its request is on its way, or not read yet."""
    exchanges: int = 64
    """Number of new connections of one address that take the place of others at once."""
    exchanges_per_s: float = 128.0
    """Number of them per second after that. What comes faster waits."""
    waiting: int = MOST_WAITING
    """Limit of the connections that wait for a place; others are refused."""
    waiting_per_address: int = MOST_WAITING_PER_ADDRESS
    """More than a program opens that does not read, and served within `wait_s`: one at the same address waits for it,
    and is not refused."""
    wait_s: float = 5.0
    """Longest time for which a connection waits for a place. After it, its request is answered with 503."""
    refused: int = MOST_REFUSED
    """Limit of the connections that are kept for a moment, until their request can be answered with 503."""

    @classmethod
    def of_this_process(cls) -> ConnectionLimits:
        """Return the limits for the number of files that this process may open."""
        # Cameras, database, workers and references need file descriptors too.
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        total = MOST_CONNECTIONS if soft == resource.RLIM_INFINITY else max(8, min(MOST_CONNECTIONS, soft // 3))
        waiting = MOST_WAITING if soft == resource.RLIM_INFINITY else max(4, min(MOST_WAITING, soft // 4))
        return cls(
            total=total,
            per_address=min(MOST_PER_ADDRESS, max(4, total // 2)),
            waiting=waiting,
            waiting_per_address=min(MOST_WAITING_PER_ADDRESS, max(2, waiting * 3 // 4)),
            refused=min(MOST_REFUSED, waiting // 2),
        )


class ConnectionTable:
    """All open connections. Used from the event loop only."""

    def __init__(self, limits: ConnectionLimits) -> None:
        self._limits = limits
        self._open: dict[int, Connection] = {}
        self._numbers: Counter[str] = Counter()
        """Number of open connections of each address."""

    def __len__(self) -> int:
        return len(self._open)

    def __iter__(self) -> Iterator[Connection]:
        return iter(list(self._open.values()))

    def has_place(self, address: str) -> bool:
        """Return whether a new connection of an address needs no place of another one."""
        return self._numbers[address] < self._limits.per_address and len(self._open) < self._limits.total

    def admit(self, new: Connection, now: float = math.inf) -> bool:
        """Add a connection, if necessary in place of another one. Return False if all others are in use.

        `now` is the time of the event loop; without it no other connection is young.
        """
        if self._numbers[new.address] >= self._limits.per_address:
            if not self._close_one([c for c in self._open.values() if c.address == new.address], now):
                return False
        elif len(self._open) >= self._limits.total and not self.make_room(now):
            return False
        self._open[id(new)] = new
        self._numbers[new.address] += 1
        return True

    def make_room(self, now: float = math.inf) -> bool:
        """Close the connection that is needed least, of the address with the most connections.

        Return whether one was closed.
        """
        by_address: dict[str, list[Connection]] = {}
        for connection in self._open.values():
            by_address.setdefault(connection.address, []).append(connection)
        crowds = sorted(by_address.values(), key=len, reverse=True)
        return any(self._close_one(crowd, now) for crowd in crowds)

    def discard(self, connection: Connection) -> None:
        """Remove a connection that has ended."""
        if self._open.pop(id(connection), None) is not None:
            self._numbers[connection.address] -= 1
            if not self._numbers[connection.address]:
                del self._numbers[connection.address]

    def _close_one(self, crowd: list[Connection], now: float) -> bool:
        idle = [(idleness, c) for c in crowd if (idleness := c.idleness()) is not None]
        if not idle:
            return False
        least, victim = min(idle, key=lambda entry: entry[0])
        # The one that is needed least is young: those that have served are not closed for it either.
        if not least.served and now - least.since < self._limits.young_s:
            return False
        self.discard(victim)
        victim.cut()
        return True

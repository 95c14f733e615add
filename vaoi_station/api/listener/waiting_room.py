"""New connections of callers that have as many as they may: they wait for a moment, in the order of their arrival.

A caller at its limit gives up one of its connections for each new one. Without a brake, a program that opens
connections and does not read makes the station begin and drop a request hundreds of times a second, which leaves little
time for other callers. So such exchanges have a rate, and what comes faster waits. A waiting connection is a bare
socket: it has neither a task nor a protocol, and its request is not read.
"""

from __future__ import annotations

import select
import socket
from collections import deque
from typing import NamedTuple

from vaoi_station.api.listener.connections import ConnectionLimits


class WaitingConnection(NamedTuple):
    """An accepted socket whose request is not read yet."""

    connected: socket.socket
    until: float
    """Time until which it waits, s on the clock of the event loop."""


class Turns:
    """The right of each caller to exchange connections: some at once, more as time passes."""

    def __init__(self, at_once: int, per_s: float) -> None:
        self._at_once, self._per_s = at_once, per_s
        self._left: dict[str, tuple[float, float]] = {}
        """Turns that a caller had left after its last one, and the time of it. Callers with all turns are absent."""

    def __len__(self) -> int:
        return len(self._left)

    def left(self, address: str, now: float) -> bool:
        """Return whether a caller has a turn."""
        return self._left_of(address, now) >= 1.0

    def take(self, address: str, now: float) -> None:
        """Use a turn of a caller that has one."""
        self._left[address] = (self._left_of(address, now) - 1.0, now)

    def forget(self, now: float) -> None:
        """Forget the callers that have all turns again, so that they do not add up."""
        self._left = {a: entry for a, entry in self._left.items() if self._left_of(a, now) < self._at_once}

    def _left_of(self, address: str, now: float) -> float:
        left, since = self._left.get(address, (self._at_once, now))
        return min(float(self._at_once), left + (now - since) * self._per_s)


class WaitingRoom:
    """The connections that wait, limited in total and for each caller. Used from the event loop only."""

    def __init__(self, limits: ConnectionLimits) -> None:
        self._limits = limits
        self._queues: dict[str, deque[WaitingConnection]] = {}
        self._size = 0
        self._refused: list[socket.socket] = []

    def __len__(self) -> int:
        return self._size + len(self._refused)

    def __contains__(self, address: str) -> bool:
        return address in self._queues

    def addresses(self) -> list[str]:
        """Return the callers that have waiting connections."""
        return list(self._queues)

    def add(self, address: str, connected: socket.socket, now: float) -> bool:
        """Let a connection wait. Return False if there is no room."""
        waiting = len(self._queues.get(address, ()))
        if waiting >= self._limits.waiting_per_address or self._size >= self._limits.waiting:
            return False
        self._queues.setdefault(address, deque()).append(WaitingConnection(connected, now + self._limits.wait_s))
        self._size += 1
        return True

    def first(self, address: str) -> WaitingConnection | None:
        """Return the connection of a caller that has waited longest; None if none waits."""
        queue = self._queues.get(address)
        return queue[0] if queue else None

    def leave(self, address: str) -> None:
        """Remove the connection of a caller that has waited longest."""
        queue = self._queues[address]
        queue.popleft()
        self._size -= 1
        if not queue:
            del self._queues[address]

    def leave_closed(self) -> None:
        """Close the waiting connections that their callers have closed, so that others come sooner."""
        everyone = {w.connected.fileno() for queue in self._queues.values() for w in queue}
        poll = select.poll()
        for number in everyone:
            # A request that was sent before does not hide that the caller has closed (poll(2)).
            poll.register(number, select.POLLRDHUP)
        closed = {number for number, _ in poll.poll(0)}
        for address, queue in list(self._queues.items()):
            gone = [w for w in queue if w.connected.fileno() in closed]
            if gone:
                self._size -= len(gone)
                self._queues[address] = deque(w for w in queue if w.connected.fileno() not in closed)
            for waiting in gone:
                waiting.connected.close()
            if not self._queues[address]:
                del self._queues[address]

    def refuse_later(self, connected: socket.socket) -> bool:
        """Keep a connection until its request has arrived, and then refuse it. Return False if there is no room."""
        if len(self._refused) >= self._limits.refused:
            return False
        self._refused.append(connected)
        return True

    def take_refused(self) -> list[socket.socket]:
        """Return the connections that are to be refused now, and forget them."""
        refused, self._refused = self._refused, []
        return refused

    def close(self) -> None:
        """Close all connections."""
        for connected in self.take_refused():
            connected.close()
        for address in self.addresses():
            while (waiting := self.first(address)) is not None:
                self.leave(address)
                waiting.connected.close()

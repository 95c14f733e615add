"""The table of connections: limits, and which connection is closed for a new one."""

from __future__ import annotations

import resource

import pytest

from vaoi_station.api.listener.connections import ConnectionLimits, ConnectionTable, Idleness

A, B = "10.0.0.1", "10.0.0.2"


class Held:
    """A connection that is idle since a given time, or busy."""

    def __init__(self, address: str, idle_since: float | None = None, served: bool = False) -> None:
        self.address, self._idle_since, self._served, self.closed = address, idle_since, served, False

    def idleness(self) -> Idleness | None:
        return None if self._idle_since is None else Idleness(self._served, self._idle_since)

    def cut(self) -> None:
        self.closed = True


def table(total: int = 4, per_address: int = 3) -> ConnectionTable:
    return ConnectionTable(ConnectionLimits(total=total, per_address=per_address))


def test_the_longest_idle_connection_of_the_address_is_closed_for_a_new_one() -> None:
    held = [Held(A, 3.0), Held(A, 1.0), Held(A, 2.0)]
    connections = table()
    assert all(connections.admit(c) for c in held)
    assert connections.admit(Held(A))
    assert [c.closed for c in held] == [False, True, False]
    assert len(connections) == 3


def test_a_connection_that_never_sent_a_request_is_closed_before_an_idle_one() -> None:
    kept_alive, half_sent = Held(A, 1.0, served=True), Held(A, 9.0)
    connections = table(per_address=2)
    assert all(connections.admit(c) for c in (kept_alive, half_sent, Held(A)))
    assert (kept_alive.closed, half_sent.closed) == (False, True)


def test_no_connection_is_closed_while_the_one_that_is_needed_least_is_young() -> None:
    """Otherwise connections in a flood would end before their requests are read, or the one of a program that waits."""
    kept_alive, new = Held(A, 1.0, served=True), Held(A, 9.0)
    connections = ConnectionTable(ConnectionLimits(per_address=2, young_s=0.25))
    assert all(connections.admit(c, 9.0) for c in (kept_alive, new))
    assert not connections.admit(Held(A), 9.2)
    assert (kept_alive.closed, new.closed) == (False, False)
    assert connections.admit(Held(A), 9.3)
    assert (kept_alive.closed, new.closed) == (False, True)


def test_requests_under_way_are_not_interrupted_for_a_new_connection() -> None:
    connections = table()
    assert all(connections.admit(Held(A)) for _ in range(3))
    assert not connections.admit(Held(A))
    assert connections.admit(Held(B))


def test_when_all_places_are_taken_the_address_with_most_connections_gives_one() -> None:
    one, many = Held(B, 0.0), [Held(A, 5.0), Held(A, 4.0), Held(A, 6.0)]
    connections = table()
    assert all(connections.admit(c) for c in (one, *many))
    assert connections.admit(Held("10.0.0.3"))
    assert (one.closed, [c.closed for c in many]) == (False, [False, True, False])


def test_an_ended_connection_frees_its_place() -> None:
    connections = table(per_address=1)
    ended = Held(A)
    assert connections.admit(ended)
    connections.discard(ended)
    assert connections.admit(Held(A))


def test_the_limits_leave_descriptors_for_the_rest_of_the_station(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (300, 4096))
    assert ConnectionLimits.of_this_process().total == 100

"""Turns and waiting connections of callers, by a clock of the test."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest

from vaoi_station.api.listener.connections import ConnectionLimits
from vaoi_station.api.listener.waiting_room import Turns, WaitingRoom

A, B, C = "10.0.0.1", "10.0.0.2", "10.0.0.3"


def taken(turns: Turns, address: str, now: float) -> int:
    """Take all turns that a caller has at a time, and return their number."""
    count = 0
    while turns.left(address, now):
        turns.take(address, now)
        count += 1
    return count


def test_a_caller_has_some_turns_at_once_and_more_as_time_passes() -> None:
    turns = Turns(at_once=4, per_s=8.0)
    assert [taken(turns, A, now) for now in (0.0, 0.0, 0.25, 0.25, 100.0)] == [4, 0, 2, 0, 4]


def test_turns_of_one_caller_do_not_end_those_of_another() -> None:
    turns = Turns(at_once=4, per_s=8.0)
    assert (taken(turns, A, 0.0), taken(turns, B, 0.0)) == (4, 4)


def test_turns_taken_one_by_one_are_no_more_than_their_rate() -> None:
    turns = Turns(at_once=4, per_s=8.0)
    assert sum(taken(turns, A, now / 100) for now in range(1000)) == pytest.approx(4 + 8 * 10, abs=1)


def test_callers_that_have_all_turns_again_are_forgotten() -> None:
    turns = Turns(at_once=4, per_s=8.0)
    for host in range(1000):
        turns.take(f"10.0.{host // 256}.{host % 256}", 0.0)
    taken(turns, A, 10.0)
    turns.forget(10.0)
    assert len(turns) == 1
    assert not turns.left(A, 10.0)


@pytest.fixture
def made() -> Iterator[Callable[[], socket.socket]]:
    """Return a function that makes a socket, which is closed after the test."""
    sockets: list[socket.socket] = []

    def make() -> socket.socket:
        sockets.append(socket.socket())
        return sockets[-1]

    yield make
    for s in sockets:
        s.close()


def test_connections_wait_in_the_order_of_their_arrival_and_for_a_time(made: Callable[[], socket.socket]) -> None:
    room = WaitingRoom(ConnectionLimits(wait_s=2.0))
    sockets = [made() for _ in range(3)]
    assert all(room.add(A, s, float(now)) for now, s in enumerate(sockets))
    for now, s in enumerate(sockets):
        first = room.first(A)
        assert first is not None
        assert (first.connected, first.until) == (s, now + 2.0)
        room.leave(A)
    assert (len(room), A in room, room.first(A)) == (0, False, None)


def test_as_many_wait_of_one_caller_and_in_all_as_permitted(made: Callable[[], socket.socket]) -> None:
    room = WaitingRoom(ConnectionLimits(waiting=5, waiting_per_address=2))
    waits = [(address, room.add(address, made(), 0.0)) for address in (A, A, A, B, B, B, C, C)]
    assert [address for address, waiting in waits if waiting] == [A, A, B, B, C]
    room.leave(A)
    assert room.add(C, made(), 0.0)


def test_connections_that_their_callers_have_closed_leave() -> None:
    room, pairs = WaitingRoom(ConnectionLimits(waiting_per_address=3)), [socket.socketpair() for _ in range(3)]
    for address, (here, there) in zip((A, A, B), pairs, strict=True):
        assert room.add(address, here, 0.0)
        there.sendall(b"GET / HTTP/1.1\r\n\r\n")
    for _, there in pairs[::2]:
        there.close()
    room.leave_closed()
    assert (len(room), room.addresses()) == (1, [A])
    first = room.first(A)
    assert first is not None
    assert first.connected is pairs[1][0]
    assert [here.fileno() for here, _ in pairs[::2]] == [-1, -1]
    for s in pairs[1]:
        s.close()


def test_as_many_are_kept_to_be_refused_as_permitted(made: Callable[[], socket.socket]) -> None:
    room, sockets = WaitingRoom(ConnectionLimits(refused=2)), [made(), made(), made()]
    assert [room.refuse_later(s) for s in sockets] == [True, True, False]
    assert len(room) == 2
    assert room.take_refused() == sockets[:2]
    assert len(room) == 0


def test_a_room_that_closes_closes_all_that_wait(made: Callable[[], socket.socket]) -> None:
    room, sockets = WaitingRoom(ConnectionLimits()), [made(), made()]
    room.add(A, sockets[0], 0.0)
    room.refuse_later(sockets[1])
    room.close()
    assert [s.fileno() for s in sockets] == [-1, -1]
    assert len(room) == 0

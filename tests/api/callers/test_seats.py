"""Seats: limits in all and for each caller, with and without a queue."""

from __future__ import annotations

import asyncio

import pytest

from vaoi_station.api.callers.seats import QueuedSeats, Seats
from vaoi_station.errors import BusyError


def test_a_caller_with_too_many_is_refused_and_another_is_not() -> None:
    seats = Seats("streams", 3, 2)
    with seats.take("a"), seats.take("a"):
        with pytest.raises(BusyError, match="a has 2 streams, the limit for one caller is 2"), seats.take("a"):
            pass
        with seats.take("b"):
            assert seats.taken == 3
            with pytest.raises(BusyError, match="All callers together have 3 streams; the limit is 3"), seats.take("c"):
                pass
    assert seats.taken == 0


def test_a_seat_is_free_again_after_an_error() -> None:
    seats = Seats("streams", 1, 1)
    with pytest.raises(ZeroDivisionError), seats.take("a"):
        raise ZeroDivisionError
    with seats.take("a"):
        assert seats.taken == 1


def test_a_caller_waits_for_its_own_seats_while_another_gets_one() -> None:
    async def run() -> list[str]:
        seats, order, go_on = QueuedSeats("pictures", 3, 1, 5, 20), [], asyncio.Event()

        async def use(caller: str, first: bool) -> None:
            async with seats.take(caller):
                order.append(caller)
                if first:
                    await go_on.wait()

        tasks = [asyncio.create_task(use(c, i == 0)) for i, c in enumerate(("a", "a", "a", "b"))]
        await tasks[3]
        assert order == ["a", "b"]
        go_on.set()
        await asyncio.gather(*tasks)
        return order

    assert asyncio.run(run()) == ["a", "b", "a", "a"]


def test_waiting_ends_after_its_time_and_the_queue_has_an_end() -> None:
    async def run() -> None:
        seats = QueuedSeats("pictures", 1, 1, 1, 0.05)
        async with seats.take("a"):
            waiting = asyncio.create_task(seats.take("a").__aenter__())
            await asyncio.sleep(0)
            with pytest.raises(BusyError, match="a has 2 pictures, waiting ones included"):
                await seats.take("a").__aenter__()
            with pytest.raises(BusyError, match=r"For 0\.05 s no other of the pictures could be made"):
                await waiting
        async with seats.take("a"):
            pass

    asyncio.run(run())

"""Blocking calls run in no more threads than their pool has."""

from __future__ import annotations

import threading
import time

import anyio

from vaoi_station.api.callers.thread_limit import ThreadLimit


def test_a_pool_runs_no_more_calls_at_a_time_than_it_has_threads() -> None:
    running, most, guard = 0, 0, threading.Lock()
    pair = threading.Barrier(2)

    def call(number: int) -> int:
        nonlocal running, most
        with guard:
            running += 1
            most = max(most, running)
        pair.wait(20)  # Passed only by two at the same time.
        with guard:
            running -= 1
        pair.wait(20)  # The next two begin after both have ended.
        return number

    async def ask_all() -> list[int]:
        pool, found = ThreadLimit(2), list[int]()

        async def ask(number: int) -> None:
            found.append(await pool.ask(call, number))

        async with anyio.create_task_group() as group:
            for number in range(8):
                group.start_soon(ask, number)
        return sorted(found)

    assert anyio.run(ask_all) == list(range(8))
    assert most == 2


def test_a_cancelled_request_does_not_wait_for_a_call_that_changes_nothing() -> None:
    ended = threading.Event()

    async def listen() -> float:
        began = time.monotonic()
        with anyio.move_on_after(0.05):
            await ThreadLimit(1).listen(ended.wait, 20)
        return time.monotonic() - began

    waited_s = anyio.run(listen)
    ended.set()
    assert waited_s < 10

"""The share of each caller: seats with and without a queue, and threads for pictures and for searches."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from fastapi.routing import APIRoute

from vaoi_station.api.event_hub import EventHub
from vaoi_station.api.limits import (
    QueuedSeats,
    Seats,
)
from vaoi_station.api.parameters import PREFIX
from vaoi_station.api.routes import board_types, cameras, mosaics, pictures
from vaoi_station.api.routes.cameras import CameraTrials
from vaoi_station.api.routes.services import COMMAND_THREADS, SEARCHES_OF_CALLER, Services
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


PATIENCE_S = 20.0


@pytest.mark.parametrize("what", ["runs?reason=glare", "runs?read_id=b", "runs/counts", "components"])
def test_commands_and_matrices_do_not_wait_for_searches(
    served: Any, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    station, release, begun = served.station, threading.Event(), threading.Semaphore(0)
    run = station.film()

    def held_up(call: Any) -> Any:
        def wait(*arguments: Any) -> Any:
            begun.release()
            release.wait(PATIENCE_S)
            return call(*arguments)

        return wait

    monkeypatch.setattr(station, "components", held_up(station.components))
    monkeypatch.setattr(station.kept, "with_id", held_up(station.kept.with_id))
    for name in ("find", "counts"):
        monkeypatch.setattr(station.kept.history, name, held_up(getattr(station.kept.history, name)))
    address = f"/api/v1/{what}" if what != "components" else f"/api/v1/runs/{run}/components"
    with ThreadPoolExecutor(COMMAND_THREADS + 4) as pool:
        try:
            searches = [pool.submit(served.client.get, address) for _ in range(COMMAND_THREADS + 4)]
            for _ in range(SEARCHES_OF_CALLER):
                assert begun.acquire(timeout=PATIENCE_S)
            assert served.client.get(f"/api/v1/runs/{run}/matrices").status_code == 200
            assert served.client.post("/api/v1/station/disarm").status_code == 200
            assert not any(search.done() for search in searches)
        finally:
            release.set()
        assert {search.result(PATIENCE_S).status_code for search in searches} == {200}


def test_every_picture_of_a_camera_or_run_takes_a_seat(station: Any) -> None:
    """Its thread and its memory are limited until it is read; a route without a seat would have neither limit."""
    services = Services(station, EventHub(station))
    routers = [module.router(services) for module in (board_types, pictures, mosaics)]
    routers.append(cameras.router(services, CameraTrials(services.coordinator)))
    routes = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    of_pictures, unlimited = set(), set()
    for route in routes:
        media = {media for reply in route.responses.values() for media in reply.get("content", {})}
        # A pulse with settings on trial has a limit of its own: one at a time.
        if ("/cameras/" in route.path and "GET" in (route.methods or ())) or any(m.startswith("image/") for m in media):
            of_pictures.add(route.path)
            if not any(of.call == services.picture_seats.hold for of in route.dependant.dependencies):
                unlimited.add(route.path)
    assert {f"{PREFIX}/cameras/{{camera}}/frame", f"{PREFIX}/runs/{{run}}/mosaics/kept.jpg"} < of_pictures
    assert unlimited == set()

"""Long polls wait without delaying other requests."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import pytest

from vaoi_station.api import event_hub as module
from vaoi_station.api.event_hub import EventHub
from vaoi_station.api.limits import Seats
from vaoi_station.errors import DeviceError

NEXT = "/api/v1/runs/next"


def test_many_waiting_requests_delay_neither_commands_nor_pictures(served: Any) -> None:
    run = served.station.film()
    limits = httpx2.Limits(max_connections=200)
    with ThreadPoolExecutor(30) as pool, httpx2.Client(base_url=served.url, timeout=30, limits=limits) as client:
        waiting = [pool.submit(client.get, NEXT, params={"after": run, "timeout": 60}) for _ in range(30)]
        wait_for_callers(served, 30)
        assert served.client.post("/api/v1/station/arm?board_type=demo-board").status_code == 200
        assert served.client.get(f"/api/v1/runs/{run}/frames/0/0").status_code == 200
        last = served.station.film()
        assert {w.result(timeout=30).json()["id"] for w in waiting} == {last}


def test_a_caller_with_too_many_long_polls_is_refused_and_keeps_its_streams(served: Any) -> None:
    served.app.state.hub.polls = Seats("long polls", 8, 1)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(served.client.get, NEXT, params={"timeout": 20})
        wait_for_callers(served, 1)
        refused = served.client.get(NEXT)
        assert (refused.status_code, refused.json()["code"]) == (503, "busy")
        assert "127.0.0.1 has 1 long polls, the limit for one caller is 1" in refused.json()["detail"]
        with served.client.stream("GET", "/api/v1/events") as stream:
            assert stream.status_code == 200
        served.station.film()
        assert waiting.result(20).status_code == 200


@pytest.mark.parametrize("fault", [RuntimeError("can't start new thread"), DeviceError("the disk does not answer")])
def test_a_read_that_fails_ends_no_waits_for_good(
    station: Any, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    """All long polls and streams depend on the one task that reads: it goes on after a fault that passes."""
    read, faults = station.events, [fault]

    def first_broken(*args: Any) -> Any:
        if faults:
            raise faults.pop()
        return read(*args)

    async def wait() -> tuple[Any, bool]:
        hub = EventHub(station)
        monkeypatch.setattr(station, "events", first_broken)
        monkeypatch.setattr(module, "RETRY_S", 0.01)
        async with hub.listening():
            newest = hub.newest
            waiting = asyncio.create_task(hub.events(newest, 10))
            while faults:
                await asyncio.to_thread(lambda: None)
            station.publish("trouble", "something", code="cable")
            return [record.message for record in await waiting], hub.closed

    assert asyncio.run(wait()) == (["something"], False)


def wait_for_callers(served: Any, count: int) -> None:
    """Poll until this number of requests wait; each poll is a request that the server handles between theirs."""
    while served.app.state.hub.waiting < count:
        served.client.get("/healthz")

"""A station over a real socket from a program with asyncio."""

from __future__ import annotations

import asyncio

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served


async def whole_cycle(served: Served) -> None:
    station = await vaoi.connect_async(served.url)
    assert (await station.arm("demo-board", board_id="SN-2", runs=1))["state"] == "armed"
    assert served.station.armed is not None
    assert served.station.armed.board_id == "SN-2"
    latest = await station.run()
    assert latest.summary["board_id"] == "SN-1"
    waiting = asyncio.create_task(station.wait_for_run(after=latest.id, timeout_s=30.0))
    second = await asyncio.to_thread(served.station.film)
    following = await waiting
    assert following is not None
    assert following.id == second
    assert (await following.result()).status == vaoi.Status.OK
    assert [image.pixels.shape for image in await following.component("U1", limit=1)] == [(64, 80)]
    assert {found.address async for found in following.pictures(limit=1)} == {"U1", "R1", "2/R1"}
    await following.hold("tester", "reads pictures")
    assert (second, "tester") in served.station.holders
    await following.release("tester")
    assert not served.station.run(second).frames_available
    assert (await station.disarm())["state"] == "idle"
    assert [run["id"] for run in await station.runs()] == [second, latest.id]


def test_a_tester_s_whole_cycle(served: Served) -> None:
    asyncio.run(whole_cycle(served))


def test_events_as_they_happen(served: Served) -> None:
    async def first_run() -> str:
        station = await vaoi.connect_async(served.url)
        after = (await station.snapshot())["last_event"]
        served.station.film()
        async for event in station.events(after):
            if event.get("state") == "ready":
                return str(event["run"])
        raise AssertionError("the station ended its events")

    assert asyncio.run(first_run()) == "r000002"


def test_refusals_are_the_errors_of_the_station(served: Served) -> None:
    async def arm() -> None:
        await (await vaoi.connect_async(served.url)).arm("unheard")

    with pytest.raises(vaoi.NotFoundError, match="unheard"):
        asyncio.run(arm())

"""A running station for programs with asyncio: the same calls as `live_station`, each in a thread.

A call that is cancelled is not waited for; its thread ends with the station's reply. The standard library has no
asynchronous HTTP client, and a tester's program has few calls at a time, so threads serve it as well.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, Unpack

from vaoi_station.library.component_images import ComponentImages
from vaoi_station.library.live_station import Station, StationRun, connect
from vaoi_station.library.picture_stream import ComponentPictures
from vaoi_station.model import Stitch
from vaoi_station.rendering.request import ImageOptions

T = TypeVar("T")


class AsyncStationRun:
    """One run of a station; see `StationRun`."""

    def __init__(self, run: StationRun) -> None:
        self._run = run

    @property
    def id(self) -> str:
        """Id of the run."""
        return self._run.id

    @property
    def summary(self) -> dict[str, Any]:
        """The reply of the station to `GET runs/{id}`."""
        return self._run.summary

    async def result(self) -> Stitch:
        """Return matrices, uncertainty and verdict of the run."""
        return await asyncio.to_thread(lambda: self._run.result)

    async def component(self, ref: str, **options: Unpack[ImageOptions]) -> ComponentImages:
        """Return the images of a component, with their pixels; see `StationRun.component`."""

        def fetch() -> ComponentImages:
            found = self._run.component(ref, **options)
            for image in found:
                _ = image.pixels  # fetched here, so that a later access does not block the event loop
            return found

        return await asyncio.to_thread(fetch)

    async def pictures(self, *components: str, **options: Unpack[ImageOptions]) -> AsyncIterator[ComponentPictures]:
        """Yield the pictures of components as they arrive; see `StationRun.pictures`."""
        async for found in _each(lambda: self._run.pictures(*components, **options)):
            yield found

    async def hold(self, holder: str, purpose: str = "") -> None:
        """Keep the frames of the run in memory; see `StationRun.hold`."""
        await asyncio.to_thread(self._run.hold, holder, purpose)

    async def release(self, holder: str | None = None) -> None:
        """Give up the frames of the run; see `StationRun.release`."""
        await asyncio.to_thread(self._run.release, holder)


class AsyncStation:
    """A connection to a running station; see `Station`."""

    def __init__(self, station: Station) -> None:
        self._station = station

    async def snapshot(self) -> dict[str, Any]:
        """Return the present state of the station."""
        return await asyncio.to_thread(self._station.snapshot)

    async def arm(
        self, board_type: str, *, board_id: str | None = None, job_id: str | None = None, runs: int | None = None
    ) -> dict[str, Any]:
        """Arm the line; see `Station.arm`."""
        return await asyncio.to_thread(
            lambda: self._station.arm(board_type, board_id=board_id, job_id=job_id, runs=runs)
        )

    async def disarm(self) -> dict[str, Any]:
        """Disarm the line."""
        return await asyncio.to_thread(self._station.disarm)

    async def runs(self, limit: int = 50) -> list[dict[str, Any]]:
        """Return summaries of the newest runs, newest first."""
        return await asyncio.to_thread(self._station.runs, limit)

    async def run(self, run_id: str = "latest") -> AsyncStationRun:
        """Return a run by its id, by default the one that finished last."""
        return AsyncStationRun(await asyncio.to_thread(self._station.run, run_id))

    async def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> AsyncStationRun | None:
        """Wait for the next finished run; see `Station.wait_for_run`."""
        found = await asyncio.to_thread(self._station.wait_for_run, after, timeout_s)
        return None if found is None else AsyncStationRun(found)

    async def events(self, after: int) -> AsyncIterator[dict[str, Any]]:
        """Yield events and heartbeats as they happen; see `Station.events`."""
        async for event in _each(lambda: self._station.events(after)):
            yield event


async def connect_async(
    address: str = "http://127.0.0.1:8350",
    *,
    key: str | None = None,
    key_file: str | Path | None = None,
    ca: str | Path | None = None,
) -> AsyncStation:
    """Connect to a running station; see `connect`."""
    return AsyncStation(await asyncio.to_thread(lambda: connect(address, key=key, key_file=key_file, ca=ca)))


async def _each(make: Callable[[], Iterator[T]]) -> AsyncIterator[T]:
    """Yield the values of a blocking iterator, each fetched in a thread when it is wanted."""
    values = await asyncio.to_thread(make)
    end: Any = object()
    while (value := await asyncio.to_thread(next, values, end)) is not end:
        yield value

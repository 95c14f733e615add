"""A running station for programs with asyncio: the methods of `live_station`, each in a thread.

A call that is cancelled is not waited for; its thread ends with the station's reply.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, Unpack

from vaoi_station.library.component_images import ComponentImages
from vaoi_station.library.live_station import MergedPicture, Station, StationBoardTypes, StationRun, connect
from vaoi_station.library.picture_stream import ComponentPictures
from vaoi_station.model import Stitch
from vaoi_station.rendering.request import ImageOptions

S = TypeVar("S")
T = TypeVar("T")
P = ParamSpec("P")


def in_thread(method: Callable[Concatenate[S, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Return the method of an `_InThreads` that calls a method of the object behind it, in a thread."""

    @functools.wraps(method)
    async def called(owner: Any, /, *args: P.args, **options: P.kwargs) -> T:
        return await asyncio.to_thread(method, owner.blocking, *args, **options)

    return called


class _InThreads(Generic[S]):
    def __init__(self, blocking: S) -> None:
        self.blocking = blocking
        """The object whose methods are called."""


class AsyncBoardTypes(_InThreads[StationBoardTypes]):
    """The board types of a station; every method is that of `StationBoardTypes`, where it is described."""

    list = in_thread(StationBoardTypes.list)
    deleted = in_thread(StationBoardTypes.deleted)
    get = in_thread(StationBoardTypes.get)
    get_tagged = in_thread(StationBoardTypes.get_tagged)
    put = in_thread(StationBoardTypes.put)
    delete = in_thread(StationBoardTypes.delete)
    set_state = in_thread(StationBoardTypes.set_state)
    set_limits = in_thread(StationBoardTypes.set_limits)
    versions = in_thread(StationBoardTypes.versions)
    version = in_thread(StationBoardTypes.version)
    restore = in_thread(StationBoardTypes.restore)
    reference = in_thread(StationBoardTypes.reference)
    teach = in_thread(StationBoardTypes.teach)
    forget_reference = in_thread(StationBoardTypes.forget_reference)
    method = in_thread(StationBoardTypes.method)
    set_method = in_thread(StationBoardTypes.set_method)
    forget_method = in_thread(StationBoardTypes.forget_method)


class AsyncStationRun(_InThreads[StationRun]):
    """One run of a station; every method is that of `StationRun`, where it is described."""

    @property
    def id(self) -> str:
        """Id of the run."""
        return self.blocking.id

    @property
    def summary(self) -> dict[str, Any]:
        """The reply of the station to `GET runs/{id}`."""
        return self.blocking.summary

    async def result(self) -> Stitch:
        """Return matrices, uncertainty and verdict of the run."""
        return await asyncio.to_thread(lambda: self.blocking.result)

    async def refs(self) -> tuple[str, ...]:
        """Return the addresses of all components of the board type."""
        return await asyncio.to_thread(lambda: self.blocking.refs)

    async def component(self, ref: str, **options: Unpack[ImageOptions]) -> ComponentImages:
        """Return the images of a component, with their pixels."""

        def fetch() -> ComponentImages:
            found = self.blocking.component(ref, **options)
            # Fetched here, so that a later access does not block the event loop.
            images = (replace(image, _load=functools.partial(_same, image.pixels)) for image in found)
            return replace(found, images=tuple(images))

        return await asyncio.to_thread(fetch)

    @functools.wraps(StationRun.merged)
    async def merged(self, *args: Any, **options: Any) -> tuple[MergedPicture, ...]:
        """Return pictures in linear radiance, with their pixels."""

        def fetch() -> tuple[MergedPicture, ...]:
            pictures = self.blocking.merged(*args, **options)
            for picture in pictures:
                _ = picture.radiance
            return pictures

        return await asyncio.to_thread(fetch)

    async def pictures(self, *components: str, **options: Unpack[ImageOptions]) -> AsyncIterator[ComponentPictures]:
        """Yield the pictures of components as they arrive."""
        async for pictures in _each(lambda: self.blocking.pictures(*components, **options)):
            yield pictures

    region = in_thread(StationRun.region)
    frame = in_thread(StationRun.frame)
    mosaics = in_thread(StationRun.mosaics)
    save_mosaic = in_thread(StationRun.save_mosaic)
    heights = in_thread(StationRun.heights)
    clamped = in_thread(StationRun.clamped)
    parts = in_thread(StationRun.parts)
    part = in_thread(StationRun.part)
    keep_as_good = in_thread(StationRun.keep_as_good)
    remove_from_good = in_thread(StationRun.remove_from_good)
    timeline = in_thread(StationRun.timeline)
    identity = in_thread(StationRun.identity)
    report_next_machine = in_thread(StationRun.report_next_machine)
    decide = in_thread(StationRun.decide)
    pin = in_thread(StationRun.pin)
    unpin = in_thread(StationRun.unpin)
    hold = in_thread(StationRun.hold)
    end_hold = in_thread(StationRun.end_hold)
    release = in_thread(StationRun.release)
    check_board_type = in_thread(StationRun.check_board_type)
    board_check_picture = in_thread(StationRun.board_check_picture)
    correct_board_type = in_thread(StationRun.correct_board_type)


class AsyncStation(_InThreads[Station]):
    """A connection to a running station; every method is that of `Station`, where it is described."""

    def __init__(self, station: Station) -> None:
        super().__init__(station)
        self.board_types = AsyncBoardTypes(station.board_types)
        """The board types of the station."""

    snapshot = in_thread(Station.snapshot)
    arm = in_thread(Station.arm)
    arm_for_orders = in_thread(Station.arm_for_orders)
    orders = in_thread(Station.orders)
    add_order = in_thread(Station.add_order)
    move_order = in_thread(Station.move_order)
    withdraw_order = in_thread(Station.withdraw_order)
    disarm = in_thread(Station.disarm)
    runs = in_thread(Station.runs)
    counts = in_thread(Station.counts)
    board = in_thread(Station.board)
    calibration = in_thread(Station.calibration)
    upload_board_data = in_thread(Station.upload_board_data)

    async def run(self, run_id: str = "latest") -> AsyncStationRun:
        """Return a run by its id, by default the one that finished last."""
        return AsyncStationRun(await asyncio.to_thread(self.blocking.run, run_id))

    async def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> AsyncStationRun | None:
        """Wait for the next finished run."""
        run = await asyncio.to_thread(self.blocking.wait_for_run, after, timeout_s)
        return None if run is None else AsyncStationRun(run)

    async def events(self, after: int) -> AsyncIterator[dict[str, Any]]:
        """Yield events and heartbeats as they happen."""
        async for event in _each(lambda: self.blocking.events(after)):
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


def _same(value: T) -> T:
    return value

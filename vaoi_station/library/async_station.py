"""A running station for programs with asyncio: the same calls as `live_station`, each in a thread.

A call that is cancelled is not waited for; its thread ends with the station's reply. The standard library has no
asynchronous HTTP client, and a tester's program has few calls at a time, so threads serve it as well.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypeVar, Unpack

from numpy.typing import NDArray

from vaoi_station.board_check.report import BoardCheck
from vaoi_station.library.board_data import ImportChoices, StationImport
from vaoi_station.library.component_images import ComponentImages
from vaoi_station.library.live_station import RunFilters, Station, connect
from vaoi_station.library.picture_stream import ComponentPictures
from vaoi_station.library.replies import MosaicReply
from vaoi_station.library.station.async_board_types import AsyncBoardTypes
from vaoi_station.library.station.station_run import Box, MergedPicture, StationRun
from vaoi_station.model import BoardType, Stitch
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.rendering.request import ImageOptions
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus
from vaoi_station.runs.states.decision_schemas import Choice, RunCounts
from vaoi_station.runs.states.height_schemas import HeightEntry
from vaoi_station.runs.states.schemas import LeaseStatus
from vaoi_station.runs.states.timeline_schemas import Timeline

T = TypeVar("T")


class AsyncStationRun:
    """One run of a station; every method is that of `StationRun`, where it is described."""

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

    async def refs(self) -> tuple[str, ...]:
        """Return the addresses of all components of the board type."""
        return await asyncio.to_thread(lambda: self._run.refs)

    async def component(self, ref: str, **options: Unpack[ImageOptions]) -> ComponentImages:
        """Return the images of a component, with their pixels."""

        def fetch() -> ComponentImages:
            found = self._run.component(ref, **options)
            for image in found:
                _ = image.pixels  # fetched here, so that a later access does not block the event loop
            return found

        return await asyncio.to_thread(fetch)

    async def pictures(self, *components: str, **options: Unpack[ImageOptions]) -> AsyncIterator[ComponentPictures]:
        """Yield the pictures of components as they arrive."""
        async for found in _each(lambda: self._run.pictures(*components, **options)):
            yield found

    async def region(self, region: Box, **options: Unpack[ImageOptions]) -> ComponentPictures:
        """Return the pictures of a part of the board."""
        return await asyncio.to_thread(lambda: self._run.region(region, **options))

    async def frame(self, camera: int, row: int, *, incomplete: bool = False) -> NDArray[Any]:
        """Return a frame as the camera delivered it."""
        return await asyncio.to_thread(self._run.frame, camera, row, incomplete=incomplete)

    async def merged(
        self,
        component: str | None = None,
        *,
        region: Box | None = None,
        light: str | None = None,
        px_per_mm: float | None = None,
        min_coverage: float | None = None,
    ) -> tuple[MergedPicture, ...]:
        """Return pictures in linear radiance, with their pixels."""

        def fetch() -> tuple[MergedPicture, ...]:
            found = self._run.merged(
                component, region=region, light=light, px_per_mm=px_per_mm, min_coverage=min_coverage
            )
            for picture in found:
                _ = picture.radiance
            return found

        return await asyncio.to_thread(fetch)

    async def mosaics(self) -> tuple[MosaicReply, ...]:
        """Return the pictures of the whole board that the station offers."""
        return await asyncio.to_thread(self._run.mosaics)

    async def save_mosaic(
        self, name: str, path: str | Path, *, region: Box | None = None, px_per_mm: float | None = None
    ) -> None:
        """Write a picture of the whole board, or of a region, to a file."""
        await asyncio.to_thread(self._run.save_mosaic, name, path, region=region, px_per_mm=px_per_mm)

    async def heights(self) -> Mapping[str, HeightEntry]:
        """Return the heights of the components above the board."""
        return await asyncio.to_thread(self._run.heights)

    async def timeline(self) -> Timeline:
        """Return the times of the steps of the run."""
        return await asyncio.to_thread(self._run.timeline)

    async def identity(self, timeout_s: float = 0.0) -> IdentityDocument:
        """Return which board the run shows."""
        return await asyncio.to_thread(self._run.identity, timeout_s)

    async def report_next_machine(self, board_id: str, machine: str = "") -> IdentityDocument:
        """Report the id that the next machine of the line has read."""
        return await asyncio.to_thread(self._run.report_next_machine, board_id, machine)

    async def decide(self, choice: Choice, name: str, reason: str) -> None:
        """Keep what a person has decided about the run."""
        await asyncio.to_thread(self._run.decide, choice, name, reason)

    async def pin(self) -> None:
        """Keep the run until it is unpinned."""
        await asyncio.to_thread(self._run.pin)

    async def unpin(self) -> None:
        """Remove the pin of the run."""
        await asyncio.to_thread(self._run.unpin)

    async def hold(self, holder: str, purpose: str = "") -> LeaseStatus:
        """Keep the frames of the run in memory."""
        return await asyncio.to_thread(self._run.hold, holder, purpose)

    async def end_hold(self, holder: str) -> None:
        """End the hold of `hold`."""
        await asyncio.to_thread(self._run.end_hold, holder)

    async def release(self, holder: str | None = None) -> None:
        """Give up the frames of the run."""
        await asyncio.to_thread(self._run.release, holder)

    async def check_board_type(self, name: str | None = None) -> BoardCheck:
        """Lay a board type of the station over the run's pictures."""
        return await asyncio.to_thread(self._run.check_board_type, name)

    async def board_check_picture(self, name: str | None = None) -> bytes:
        """Return the picture of `check_board_type` as JPEG."""
        return await asyncio.to_thread(self._run.board_check_picture, name)

    async def correct_board_type(self, name: str, revision: str | None = None) -> BoardType:
        """Store the correction that `check_board_type` proposes, as a draft."""
        return await asyncio.to_thread(self._run.correct_board_type, name, revision)


class AsyncStation:
    """A connection to a running station; every method is that of `Station`, where it is described."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self.board_types = AsyncBoardTypes(station.board_types)
        """The board types of the station."""

    async def snapshot(self) -> dict[str, Any]:
        """Return the present state of the station."""
        return await asyncio.to_thread(self._station.snapshot)

    async def arm(
        self,
        board_type: str,
        *,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
        passing: Passing | None = None,
    ) -> dict[str, Any]:
        """Arm the line."""
        return await asyncio.to_thread(
            lambda: self._station.arm(
                board_type,
                board_id=board_id,
                job_id=job_id,
                runs=runs,
                allow_lost_cameras=allow_lost_cameras,
                passing=passing,
            )
        )

    async def disarm(self) -> dict[str, Any]:
        """Disarm the line."""
        return await asyncio.to_thread(self._station.disarm)

    async def runs(self, limit: int = 50, **filters: Unpack[RunFilters]) -> list[dict[str, Any]]:
        """Return summaries of runs, newest first."""
        return await asyncio.to_thread(lambda: self._station.runs(limit, **filters))

    async def counts(self, since: str | datetime | None = None) -> RunCounts:
        """Return the numbers of boards by verdict."""
        return await asyncio.to_thread(self._station.counts, since)

    async def calibration(self) -> CalibrationStatus:
        """Return the calibration in force."""
        return await asyncio.to_thread(self._station.calibration)

    async def run(self, run_id: str = "latest") -> AsyncStationRun:
        """Return a run by its id, by default the one that finished last."""
        return AsyncStationRun(await asyncio.to_thread(self._station.run, run_id))

    async def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> AsyncStationRun | None:
        """Wait for the next finished run."""
        found = await asyncio.to_thread(self._station.wait_for_run, after, timeout_s)
        return None if found is None else AsyncStationRun(found)

    async def events(self, after: int) -> AsyncIterator[dict[str, Any]]:
        """Yield events and heartbeats as they happen."""
        async for event in _each(lambda: self._station.events(after)):
            yield event

    async def upload_board_data(
        self, path: str | Path, side: Literal["top", "bottom"] = "top", **choices: Unpack[ImportChoices]
    ) -> StationImport:
        """Send a file of a CAD system or placement machine; the methods of the reply block."""
        return await asyncio.to_thread(lambda: self._station.upload_board_data(path, side, **choices))


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

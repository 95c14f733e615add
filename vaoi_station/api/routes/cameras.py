"""Routes under `cameras`: the newest frame of each in memory with its figures, and pulses with settings on trial."""

from __future__ import annotations

import itertools
import threading
from contextlib import suppress
from typing import Annotated

import cv2
import numpy as np
from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import Camera, file_reply, rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import NotFoundError, VaoiError
from vaoi_station.files.images import Image, encode_jpeg
from vaoi_station.model import FrameRecord, Strict
from vaoi_station.photometry.image_quality import full_scale, histogram, measure_quality
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.lighting.trials import TRIAL_S, TrialSettings
from vaoi_station.runs.states.schemas import RunDetail

JPEG = file_reply("The picture.", "image/jpeg")
LARGEST_PX = 960
"""Longest side of the picture of a card."""
_NEWEST_RUNS = 4
"""Number of runs in which a frame of a camera is searched: the newest may have lost all of its frames."""
_QUALITY = 80


class SharpnessTile(BaseModel):
    """The sharpness of one of the 3 × 3 parts of a frame."""

    column: int
    row: int
    blur_px: float | None = None
    """Standard deviation of the blur across edges, px; absent if the part has too few edges."""


class FrameFigures(BaseModel):
    """The figures of one frame. Grey levels are shares of the full scale."""

    width: int
    height: int
    focus: float
    """Figure of focus: a higher value is sharper. Comparable only between frames of the same scene."""
    blur_px: float | None = None
    """Standard deviation of the blur across edges, px, of the whole frame; absent if there are too few edges."""
    mtf50: float | None = None
    """Spatial frequency, cycles per pixel, at which the modulation falls to one half."""
    tiles: tuple[SharpnessTile, ...]
    mean: float
    low: float
    """Grey level below which 1 % of the pixels lie."""
    high: float
    """Grey level below which 99 % of the pixels lie."""
    saturated: float
    """Share of the pixels at full scale."""
    histogram: tuple[float, ...]
    """Share of the pixels in each of 64 equal steps of grey, from dark to bright."""


class CameraFrame(FrameFigures):
    """The newest frame of a camera that is in memory, and its figures."""

    camera: int
    run: str
    row: int
    light: str
    exposure_us: float | None = None
    gain: float | None = None
    link_mbit_s: float | None = None
    """Mean data rate of the camera while the run was filmed, Mbit/s; absent while it is."""


class CameraTrialRequest(Strict):
    """Settings that one camera is to try with one pulse; what is absent is as in station.toml."""

    light: str | None = Field(default=None, min_length=1, max_length=100, description="Name of a light.")
    on_us: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False, description="On-time of its LEDs.")
    exposure_us: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False, description="Exposure time.")
    gain_db: float | None = Field(default=None, ge=-60, le=60, allow_inf_nan=False, description="Gain.")


class CameraTrialFrame(FrameFigures):
    """A frame that was taken with settings on trial, and its figures."""

    camera: int
    number: int
    """Number of the trial, for its picture."""
    light: str
    on_us: float | None = None
    exposure_us: float
    gain_db: float
    expires_in_s: float
    """Time until the settings of station.toml are set again, without another trial."""


class NewestFrames:
    """Measures frames for the cards of cameras. Its methods may be called from any thread."""

    def __init__(self, coordinator: StationCoordinator) -> None:
        self._coordinator = coordinator
        self._measured: dict[int, CameraFrame] = {}
        self._measuring: dict[int, threading.Lock] = {}
        """A lock for each camera: callers who ask for the same new frame wait until one of them has measured it."""

    def frame(self, camera: int) -> CameraFrame:
        """Return the figures of a camera's newest frame in memory.

        Raises:
            NotFoundError: the station has no such camera, or none of its frames is in memory.
        """
        count = len(self._coordinator.snapshot().cameras)
        if camera >= count:
            raise NotFoundError(
                f"There is no camera {camera}; the station has {count}.", action="See cameras of GET station."
            )
        with self._measuring.setdefault(camera, threading.Lock()):
            return self._newest(camera)

    def picture(self, camera: int, run: str | None, row: int | None, largest_px: int = LARGEST_PX) -> bytes:
        """Return a frame as JPEG of 8 bits: without a run and a row the newest, else also an incomplete one."""
        if run is None or row is None:
            newest = self.frame(camera)
            run, row = newest.run, newest.row
        return for_display(self._coordinator.frame(run, camera, row, allow_incomplete=True)[0], largest_px)

    def _newest(self, camera: int) -> CameraFrame:
        """Return the figures of a camera's newest frame; the caller holds the lock of the camera."""
        known, candidates = self._measured.get(camera), self._candidates(camera)
        for run, record in candidates:
            if known is not None:
                newest = (known.run, known.row) == (run.id, record.row) and known.link_mbit_s is not None
                # While a board is filmed, each row would be measured, and would take time from the station.
                if newest or (run.finished is None and any(known.run == other.id for other, _ in candidates)):
                    return known
            try:
                pixels, _ = self._coordinator.frame(run.id, camera, record.row)
            except VaoiError:
                continue  # its memory was given to a later board meanwhile
            self._measured[camera] = found = _measured(run, record, pixels)
            return found
        name = self._coordinator.snapshot().cameras[camera].name
        raise NotFoundError(f"No frame of camera {name} is in memory.", action="Let a board pass.", code="no-frame-yet")

    def _candidates(self, camera: int) -> list[tuple[RunDetail, FrameRecord]]:
        """Return for each of the newest runs the last good frame of a camera, newest run first."""
        found = []
        for summary in self._coordinator.runs(_NEWEST_RUNS):
            if summary.frames_available or summary.finished is None:
                with suppress(VaoiError):  # it was forgotten meanwhile
                    run = self._coordinator.run(summary.id)
                    good = [frame for frame in run.frames if frame.camera == camera and frame.usable]
                    found += [(run, good[-1])] if good else []
        return found


class CameraTrials:
    """Tries settings, and keeps the newest frame for its picture. Methods may be called from any thread."""

    def __init__(self, coordinator: StationCoordinator) -> None:
        self._coordinator = coordinator
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._newest: tuple[int, int, Image] | None = None
        """Camera, number and pixels of the newest frame."""

    def shoot(self, camera: int, wanted: CameraTrialRequest) -> CameraTrialFrame:
        """Fire one pulse with these settings; return the figures of the camera's frame."""
        settings = TrialSettings(wanted.light, wanted.on_us, wanted.exposure_us, wanted.gain_db)
        taken = self._coordinator.lighting.try_settings(camera, settings)
        with self._lock:
            number = next(self._numbers)
            self._newest = camera, number, taken.pixels
        settings_used = {name: getattr(taken, name) for name in ("light", "on_us", "exposure_us", "gain_db")}
        figures = figures_of(taken.pixels).model_dump()
        return CameraTrialFrame(camera=camera, number=number, expires_in_s=TRIAL_S, **settings_used, **figures)

    def frame(self, camera: int, number: int | None) -> Image:
        """Return the newest frame; `NotFoundError` if it is of another camera or trial, or there is none."""
        with self._lock:
            newest = self._newest
        if newest is None or newest[0] != camera or number not in (None, newest[1]):
            raise NotFoundError(f"There is no trial of camera {camera}.", action="Fire a pulse.", code="no-trial-frame")
        return newest[2]

    def end(self) -> None:
        """Set the exposures of station.toml again, and forget the picture."""
        self._coordinator.lighting.end_trial()
        with self._lock:
            self._newest = None


def router(services: Services, trials: CameraTrials) -> APIRouter:
    """Create the routes for cameras."""
    routes, frames = rest_router(prefix="/cameras/{camera}", tags=["station"]), NewestFrames(services.coordinator)
    # One pulse at a time; a caller that comes meanwhile waits for a moment.
    shooting = ThreadLimit(1)
    # Measuring a frame takes a thread of pictures, so that it takes a seat for pictures as well.
    seat = [Depends(services.picture_seats.hold)]

    @routes.get("/frame", dependencies=seat)
    async def get_camera_frame(camera: Camera) -> CameraFrame:
        """Return the figures of a camera's newest frame in memory: sharpness over the field, histogram, exposure.

        404 `no-frame-yet`: no frame of the camera is in memory. State, temperature, packets: `cameras` of GET station.
        """
        return await services.pictures.ask(frames.frame, camera)

    @routes.get("/picture", response_class=Response, responses=JPEG, dependencies=seat)
    async def get_camera_picture(
        camera: Camera,
        run: Annotated[str | None, Query(description="Run of the frame.", min_length=1, max_length=64)] = None,
        row: Annotated[int | None, Query(description="Row of the frame.", ge=0, le=99999)] = None,
        largest_px: Annotated[
            int, Query(description="Longest side of the picture.", ge=64, le=LARGEST_PX)
        ] = LARGEST_PX,
    ) -> Response:
        """Return a frame as JPEG of at most 960 px, for display; without `run` and `row` the newest in memory.

        With them also an incomplete or unproven one, of a run that is in memory or kept as a recording. Without loss,
        and in full size: `runs/{run}/frames/{camera}/{row}`.
        """
        content = await services.pictures.ask(frames.picture, camera, run, row, largest_px)
        return Response(content, media_type="image/jpeg")

    @routes.post("/trial")
    async def try_camera_settings(camera: Camera, body: CameraTrialRequest) -> CameraTrialFrame:
        """Fire one pulse with settings on trial while the line is disarmed; return the figures of the camera's frame.

        Nothing is changed for good: arming ends the trial, and 10 s after the last pulse the settings of station.toml
        are set again. 409 `line-armed`: the line is armed; 409 `trial-running`: another pulse is under way.
        """
        return await shooting.ask(trials.shoot, camera, body)

    @routes.delete("/trial", status_code=204)
    async def end_camera_trial(camera: Camera) -> None:  # noqa: ARG001  a trial has one camera at a time
        """Set the settings of station.toml again, now."""
        await services.commands.ask(trials.end)

    @routes.get("/trial/picture", response_class=Response, responses=JPEG, dependencies=seat)
    async def get_camera_trial_picture(
        camera: Camera,
        number: Annotated[int | None, Query(description="Number of the trial [the newest].", ge=1, le=10**9)] = None,
    ) -> Response:
        """Return the newest frame of a trial as JPEG of at most 960 px. 404 `no-trial-frame`: there is none."""
        content = await services.pictures.ask(lambda: for_display(trials.frame(camera, number)))
        return Response(content, media_type="image/jpeg")

    return routes


def for_display(pixels: Image, largest_px: int = LARGEST_PX) -> bytes:
    """Return a frame as JPEG of 8 bits, at most `largest_px` long."""
    scale = largest_px / max(pixels.shape[:2])
    if scale < 1:
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if pixels.dtype != np.uint8:
        pixels = cv2.convertScaleAbs(pixels, alpha=255 / full_scale(pixels))
    return encode_jpeg(pixels, _QUALITY)


def _measured(run: RunDetail, record: FrameRecord, pixels: Image) -> CameraFrame:
    filming_s = run.timings.filming_s if run.timings else 0.0
    good = sum(frame.camera == record.camera and frame.usable for frame in run.frames)
    return CameraFrame(
        camera=record.camera,
        run=run.id,
        row=record.row,
        light=record.light,
        exposure_us=record.exposure_us,
        gain=record.gain,
        link_mbit_s=round(good * pixels.nbytes * 8e-6 / filming_s, 1) if filming_s > 0 else None,
        **figures_of(pixels).model_dump(),
    )


def figures_of(pixels: Image) -> FrameFigures:
    """Measure sharpness and grey levels of a frame."""
    quality = measure_quality(pixels)
    return FrameFigures(
        width=pixels.shape[1],
        height=pixels.shape[0],
        focus=float(f"{quality.focus:.5g}"),
        blur_px=_rounded(quality.blur_px),
        mtf50=_rounded(quality.mtf50),
        tiles=tuple(
            SharpnessTile(column=column, row=row, blur_px=_rounded(blur))
            for row, blurs in enumerate(quality.blur_tiles_px)
            for column, blur in enumerate(blurs)
        ),
        mean=round(quality.mean, 4),
        low=round(quality.low, 4),
        high=round(quality.high, 4),
        saturated=round(quality.saturated, 6),
        histogram=histogram(pixels),
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)

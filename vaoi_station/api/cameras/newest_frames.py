"""The newest frame of each camera that is in memory, and its figures, measured once per frame."""

from __future__ import annotations

import threading
from collections import defaultdict

import cv2
import numpy as np

from vaoi_station.api.cameras.models import CameraFrame, FrameFigures, SharpnessTile
from vaoi_station.errors import NotFoundError, VaoiError
from vaoi_station.files.images import Image, encode_jpeg
from vaoi_station.model import FrameRecord
from vaoi_station.photometry.image_quality import full_scale, histogram, measure_quality
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import RunDetail

LARGEST_PX = 960
"""Longest side of the picture of a card."""
_NEWEST_RUNS = 4
"""Number of runs in which a frame of a camera is searched: the newest may have lost all of its frames."""
_QUALITY = 80


class NewestFrames:
    """Measures frames for the cards of cameras. Its methods may be called from any thread."""

    def __init__(self, coordinator: StationCoordinator) -> None:
        self._coordinator = coordinator
        self._measured: dict[int, CameraFrame] = {}
        self._lock = threading.Lock()
        self._measuring: defaultdict[int, threading.Lock] = defaultdict(threading.Lock)
        """A lock for each camera: callers who ask for the same new frame wait until one of them has measured it."""

    def frame(self, camera: int) -> CameraFrame:
        """Return the figures of a camera's newest frame in memory.

        Raises:
            NotFoundError: the station has no such camera, or none of its frames is in memory.
        """
        names = [c.name for c in self._coordinator.snapshot().cameras]
        if camera >= len(names):
            raise NotFoundError(
                f"There is no camera {camera}; the station has {len(names)}.", action="See cameras of GET station."
            )
        with self._lock:
            measuring = self._measuring[camera]
        with measuring:
            return self._newest(camera, names[camera])

    def _newest(self, camera: int, name: str) -> CameraFrame:
        """Return the figures of a camera's newest frame; the caller holds the lock of the camera."""
        candidates = self._candidates(camera)
        runs = {run.id for run, _ in candidates}
        for run, record in candidates:
            with self._lock:
                known = self._measured.get(camera)
            if known is not None:
                filming = run.finished is None
                newest = (known.run, known.row) == (run.id, record.row) and known.link_mbit_s is not None
                # While a board is filmed, each row would be measured, and would take time from the station.
                if newest or (filming and known.run in runs):
                    return known
            try:
                pixels, _ = self._coordinator.frame(run.id, camera, record.row)
            except VaoiError:
                continue  # its memory was given to a later board meanwhile
            found = _measured(run, record, pixels)
            with self._lock:
                self._measured[camera] = found
            return found
        raise NotFoundError(f"No frame of camera {name} is in memory.", action="Let a board pass.", code="no-frame-yet")

    def picture(self, camera: int, run: str | None, row: int | None) -> bytes:
        """Return a frame as JPEG of 8 bits, at most `LARGEST_PX` long: without a run and a row, the newest."""
        if run is None or row is None:
            newest = self.frame(camera)
            run, row = newest.run, newest.row
        return for_display(self._coordinator.frame(run, camera, row)[0])

    def _candidates(self, camera: int) -> list[tuple[RunDetail, FrameRecord]]:
        """Return for each of the newest runs the last good frame of a camera, newest run first."""
        found = []
        for summary in self._coordinator.runs(_NEWEST_RUNS):
            if not summary.frames_available and summary.finished is not None:
                continue
            try:
                run = self._coordinator.run(summary.id)
            except VaoiError:
                continue  # it was forgotten meanwhile
            good = [frame for frame in run.frames if frame.camera == camera and frame.usable]
            if good:
                found.append((run, good[-1]))
        return found


def for_display(pixels: Image) -> bytes:
    """Return a frame as JPEG of 8 bits, at most `LARGEST_PX` long."""
    scale = LARGEST_PX / max(pixels.shape[:2])
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

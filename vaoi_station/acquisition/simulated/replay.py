"""Replay recordings in place of the line, the cameras and the controller."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.replay import ReplayCamera
from vaoi_station.acquisition.controller.replay import RecordedRow, ReplayController
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.acquisition.devices import Devices, Feedback
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files import Recording, open_recording
from vaoi_station.pixel_formats import PIXEL_FORMATS

CACHED_RECORDINGS = 4
"""Count of recordings whose decoded frames are kept in memory."""
ROW_TIMEOUT_S = 2.0
"""Longest time for which a fast replay waits until the frames of a row are processed, s."""

Pixels = dict[tuple[int, int], NDArray[np.uint8]]


def open_replay(config: StationConfig) -> Devices:
    """Open cameras and controller that play `config.replay`.

    Raises:
        InputError: a recording does not fit this station.
    """
    assert config.replay is not None
    recordings = [open_recording(path) for path in config.replay.recordings]
    for recording in recordings:
        _check(recording, config)
    clock, feedback = DeviceClock(), Feedback()
    cameras = tuple(ReplayCamera(n, clock) for n in range(len(config.cameras)))
    formats = tuple(camera.pixel_format for camera in config.cameras)
    decode = lru_cache(maxsize=CACHED_RECORDINGS)(partial(_decode, formats=formats))
    # Decoded before the line is armed: the first run must not wait for the disk.
    decode(recordings[0])
    order = cycle(recordings)
    runs = (_rows(r, cameras, decode(r)) for r in (islice(order, config.replay.runs) if config.replay.runs else order))
    pace = FastPace(feedback) if config.replay.pace == "fast" else None
    return Devices(cameras, ReplayController(runs, clock, config.replay.pause_s, pace), feedback)


class FastPace:
    """The pace of a fast replay. A run begins when memory is available; a pulse comes when earlier frames are done."""

    def __init__(self, feedback: Feedback) -> None:
        self._feedback = feedback
        self._expected = 0

    def before_run(self, stop: Callable[[], bool]) -> None:
        """Wait until there is memory for a run."""
        self._feedback.wait_for_memory(stop)
        self._expected = self._feedback.frames_done()

    def before_pulse(self, stop: Callable[[], bool]) -> None:
        """Wait until all delivered frames are done, at most `ROW_TIMEOUT_S`: a frame without a slot is never done."""
        self._feedback.wait_for_frames(self._expected, stop, ROW_TIMEOUT_S)

    def frames_coming(self, frames: int) -> None:
        """Add `frames` to the number of frames that must be done before the next pulse."""
        self._expected += frames

    def wake(self) -> None:
        """Let waiting threads evaluate their function `stop` again."""
        self._feedback.wake()


def _rows(recording: Recording, cameras: tuple[ReplayCamera, ...], pixels: Pixels) -> list[RecordedRow]:
    head = recording.head
    times = head.row_times_s()

    def show(row: int, device_s: float) -> int:
        for n, camera in enumerate(cameras):
            camera.play(device_s, pixels.get((n, row)))
        return sum((n, row) in pixels for n in range(len(cameras)))

    return [
        RecordedRow(
            round(float(times[row] - times[0]), 9),
            head.lights[row] if head.lights else "",
            head.exposures_us[row] if head.exposures_us else (),
            partial(show, row),
            head.gains[row] if head.gains else (),
        )
        for row in range(head.rows)
    ]


def _decode(recording: Recording, formats: tuple[str, ...]) -> Pixels:
    """Return all frames of a recording as flat bytes, in the form in which cameras of these pixel formats send them."""
    frames: Pixels = {}
    for n, pixel_format in enumerate(formats):
        for row in range(recording.head.rows):
            image = recording.frame(n, row)
            if image is None:
                continue
            if image.ndim != 2 or image.dtype != PIXEL_FORMATS[pixel_format].dtype:
                shown = f"{image.dtype.itemsize * 8} bit {'grey' if image.ndim == 2 else 'colour'}"
                raise InputError(
                    f"{recording.frame_path(n, row)}: is {shown}, but camera {n} of the station is {pixel_format}.",
                    action="Set pixel_format of the camera to that of the recording.",
                )
            frames[n, row] = np.ascontiguousarray(image).reshape(-1).view(np.uint8)
    return frames


def _check(recording: Recording, config: StationConfig) -> None:
    """Raise InputError for a recording that does not have this station's cameras and line."""
    head, where = recording.head, recording.directory / "recording.json"
    if len(head.cameras) != len(config.cameras):
        raise InputError.field(where, "cameras", len(head.cameras), f"{len(config.cameras)}, as in station.toml")
    for n, (filmed, ours) in enumerate(zip(head.cameras, config.cameras, strict=True)):
        if (filmed.width, filmed.height) != (ours.width, ours.height):
            size = f"{ours.width}×{ours.height} px, as in station.toml"
            raise InputError.field(where, f"cameras[{n}]", f"{filmed.width}×{filmed.height} px", size)
    line = config.line
    if head.rows > config.rows_per_run:
        limit = f"at most the {config.rows_per_run} slots per camera of the ring"
        raise InputError.field(where, "rows", head.rows, limit, "Raise [line] longest_board_mm or [ring] spare_rows.")
    if not math.isclose(head.trigger_period_s, line.trigger_period_s, rel_tol=1e-6):
        raise InputError.field(where, "trigger_period_s", head.trigger_period_s, f"{line.trigger_period_s} ([line])")
    if not np.allclose(head.conveyor_mm_s, line.conveyor_mm_s, rtol=1e-6, atol=1e-6):
        raise InputError.field(where, "conveyor_mm_s", head.conveyor_mm_s, f"{line.conveyor_mm_s} ([line])")

"""Stitching of a complete recording, with the same tasks as in the station, but one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from vaoi_station.model import RecordingHead, Stitch
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

Frames = Callable[[int, int], NDArray[Any] | None]
KEPT_BYTES = 256_000_000
"""Size of the frames of a run that stay in memory while it is stitched."""


def kept_frames(frame: Frames, most_bytes: int = KEPT_BYTES) -> Frames:
    """Return a function that keeps the first frames it returns, up to a size, and reads the others each time.

    The conclusion of a run reads every frame several times, in other orders than the tasks.
    """
    kept: dict[tuple[int, int], NDArray[Any]] = {}
    room = most_bytes

    def kept_frame(camera: int, row: int) -> NDArray[Any] | None:
        nonlocal room
        if (pixels := kept.get((camera, row))) is not None:
            return pixels
        pixels = frame(camera, row)
        # No frame replaces a kept one: where all are read in turns, the one used longest ago is the one needed next.
        if pixels is not None and pixels.nbytes <= room:
            kept[camera, row] = pixels
            room -= pixels.nbytes
        return pixels

    return kept_frame


def stitch_frames(
    setup: StitchSetup, head: RecordingHead, frame: Frames, reference_frame: Frames | None = None
) -> Stitch:
    """Stitch the frames of a finished run.

    Args:
        setup: inputs that are known before the board is filmed.
        head: head of the recording, with cameras, rows and times.
        frame: function that returns the pixels of a camera and a row; None where a frame never arrived.
        reference_frame: the same function for the frames of the reference, if `setup` has a reference.
    """
    # A run with missing frames is stitched from the other frames. Only the tasks of the missing frames are left out.
    lost = set(head.missing)
    present = [(i, j) for i in range(len(head.cameras)) for j in range(head.rows) if (i, j) not in lost]
    times_s = head.motion_times_s()
    runner = TaskRunner(setup, kept_frames(frame), reference_frame)
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
    return runner.conclude(times_s, present, evidence, head.doubts)

"""Heads of the recordings of finished runs, and the sizes of their frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from numpy.typing import NDArray

from vaoi_station.model import FrameRecord, RecordingHead
from vaoi_station.runs.states.schemas import RunDetail


def head_of(run: RunDetail, head: RecordingHead) -> RecordingHead:
    """Return the head of the recording: frames that are not usable are missing, with causes under `x_verdicts`."""
    frames = run.frames
    there = {(f.camera, f.row) for f in frames if f.usable and f.slot is not None}
    everything = {(i, j) for i in range(len(head.cameras)) for j in range(head.rows)}
    bad = [
        {"camera": f.camera, "row": f.row, "verdict": str(f.verdict), "cause": f.cause} for f in frames if not f.usable
    ]
    missing = tuple(sorted(everything - there | set(head.missing)))
    return head.model_copy(update={"missing": missing, "x_run": run.id, "x_verdicts": bad})


def bytes_of_frames(frames: Iterable[FrameRecord], head: RecordingHead, copy: Callable[[int], NDArray[Any]]) -> int:
    """Return the size of the frames on disk, from one frame of every camera: its pixel format is nowhere else."""
    absent, sizes = set(head.missing), dict[int, int]()
    for frame in frames:
        if frame.camera not in sizes and (frame.camera, frame.row) not in absent and frame.slot is not None:
            sizes[frame.camera] = copy(frame.slot).nbytes
    return sum(sizes.values()) * head.rows

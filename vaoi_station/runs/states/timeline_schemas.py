"""Schemas of the times of a run's steps. The documents are immutable and become JSON as they are."""

from __future__ import annotations

from vaoi_station.runs.states.schemas import Schema


class TaskTiming(Schema):
    """Times of one task of a run, in seconds since the board interrupted the barrier, by the host's clock."""

    kind: str
    camera: int
    row: int
    other_camera: int | None
    other_row: int | None
    ready_s: float
    """Time at which the last of the task's frames was settled."""
    done_s: float
    worker_ms: float


class Timeline(Schema):
    """Times of the steps of a run, in seconds since the board interrupted the barrier, by the host's clock."""

    frames_settled_s: tuple[tuple[int, int, float], ...]
    """(camera, row, time) of every settled frame."""
    tasks: tuple[TaskTiming, ...]
    last_frame_s: float
    ready_s: float | None

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


class RowTiming(Schema):
    """Pulse, light and exposure of one row."""

    row: int
    pulse_s: float
    """Time of the pulse since the board interrupted the barrier, by the controller's clock."""
    light: str = ""
    """Name of the light; empty if lights have no names."""
    led_us: float | None = None
    """On-time of the LEDs by the light program; None if they shine for the whole exposure, or without a program."""
    exposure_us: float
    """Longest exposure of a camera in this row: for how long its shutter is open."""


class BarrierTiming(Schema):
    """One interruption of the light barrier, since the first one of the run, by the controller's clock."""

    blocked_s: float
    clear_s: float | None = None
    """None if the barrier was still interrupted when the run ended."""


class Timeline(Schema):
    """Times of the steps of a run, in seconds since the board interrupted the barrier.

    Frames, tasks and the result have the times of the host's clock, pulses and the barrier those of the controller's.
    """

    frames_settled_s: tuple[tuple[int, int, float], ...]
    """(camera, row, time) of every settled frame."""
    tasks: tuple[TaskTiming, ...]
    last_frame_s: float
    ready_s: float | None
    rows: tuple[RowTiming, ...] = ()
    """Every row; empty in runs of earlier versions, and where the controller reports no interruptions."""
    barrier: tuple[BarrierTiming, ...] = ()
    """The interruptions of the light barrier; empty likewise."""

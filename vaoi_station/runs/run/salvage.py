"""Runs that ended early: the reason of their verdict, and the report of a run whose acquisition process has ended."""

from __future__ import annotations

from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.config import StationConfig
from vaoi_station.line_config import row_ways_mm
from vaoi_station.model import CameraHead, FrameRecord, RecordingHead, Verdict
from vaoi_station.model.light_program import row_of
from vaoi_station.runs.run.progress import WHOLE, Progress
from vaoi_station.runs.states.schemas import Reason

CAUSE = "the acquisition process ended before it arrived"
"""Cause of missing frames that is stated in their records."""


def camera_heads(config: StationConfig) -> tuple[CameraHead, ...]:
    """Return the camera heads of this station's recordings."""
    return tuple(c.head for c in config.cameras)


def early_end_reason(report: RunFinished) -> Reason | None:
    """Return a reason if the pulses of a run ended although the board may not have left; None for a normal end."""
    if report.reason in WHOLE or report.reason == "max-rows":
        return None  # The reason of a run with too many rows comes from `BoardAccount`.
    return Reason(
        code="run-cut-short",
        message=f"After row {report.head.rows - 1} nothing more was filmed: {report.reason}.",
        action="Film the board again if the pictures do not suffice.",
    )


def salvage_recording(progress: Progress, config: StationConfig) -> RunFinished | None:
    """Build the final report of a run from the pulses and frames that were reported so far; None if there is no row.

    The acquisition process has ended and can no longer send this report. Frames that were not reported get the verdict
    MISSING.
    """
    rows = 0
    # Only rows before the first missing pulse are used: later rows have no certain time.
    while rows in progress.pulses:
        rows += 1
    if not rows:
        return None
    keys = [(camera, row) for camera in range(len(config.cameras)) for row in range(rows)]
    frames = tuple(
        progress.frames.get(key) or FrameRecord(camera=key[0], row=key[1], verdict=Verdict.MISSING, cause=CAUSE)
        for key in keys
    )
    # Times are relative to the first pulse and rounded to 1 ns, as the acquisition process does it. So the tasks that
    # were requested while filming remain valid.
    first_s = progress.pulses[0].time_s
    line, plan = progress.order.line or config.line, progress.order.plan
    lights = tuple(progress.pulses[row].light for row in range(rows))
    program = plan.program if plan is not None else ()
    filmed = [expected for row in range(rows) if (expected := row_of(program, row)) is not None]
    head = RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=camera_heads(config),
        rows=rows,
        trigger_period_s=line.trigger_period_s,
        conveyor_mm_s=line.conveyor_mm_s,
        rotation_deg=config.line.expected_board.rotation_deg or None,
        missing=tuple((f.camera, f.row) for f in frames if f.verdict is Verdict.MISSING),
        trigger_times_s=tuple(round(progress.pulses[row].time_s - first_s, 9) for row in range(rows)),
        belt_mm=None if plan is None or plan.belt is None else row_ways_mm(plan.belt.row_mm, rows),
        exposures_us=tuple(row.lit_us for row in filmed) or None,
        gains=tuple(row.gains for row in filmed) or None,
        lights=lights if any(lights) else None,
    )
    last_s = max((at for key, at in progress.settled_s.items() if key in progress.present), default=progress.barrier_s)
    return RunFinished(progress.run, progress.context.bay, head, frames, last_s, "acquisition lost")

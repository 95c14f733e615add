"""The times of a run's steps become JSON as they are, and refuse unknown keys."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.runs.states.timeline_schemas import TaskTiming, Timeline

TASK = TaskTiming(
    kind="row", camera=0, row=1, other_camera=None, other_row=None, ready_s=0.5, done_s=0.75, worker_ms=20.0
)


def test_a_timeline_survives_json() -> None:
    timeline = Timeline(frames_settled_s=((0, 0, 0.25),), tasks=(TASK,), last_frame_s=0.25, ready_s=None)
    assert Timeline.model_validate_json(timeline.model_dump_json()) == timeline


def test_unknown_keys_are_refused() -> None:
    with pytest.raises(ValidationError, match="extra"):
        TaskTiming.model_validate({**TASK.model_dump(), "colour": "red"})

"""The belt as a board saw it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.model import RecordingHead, Status, Stitch
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import (
    belt_speed,
    detail_of,
    timeline_of,
)
from vaoi_station.runs.workers.jobs import Concluded


def stitch_of(vx: float, vy: float, turn: float, about: tuple[float, float], times: np.ndarray) -> Stitch:
    """Return a board that moves evenly and turns evenly about a point of its own."""
    rows = []
    for t in times:
        a = turn * t
        r = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        shift = np.asarray(about) + np.array([vx, vy]) * t - r @ np.asarray(about)
        rows.append(np.vstack([np.column_stack([r, shift]), [0, 0, 1]]))
    return Stitch(
        method="auto",
        image_matrices=((None,) * len(times),),
        cad_matrix=None,
        row_motion=tuple(rows),
        status=Status.OK,
    )


@given(
    st.floats(-5, 5), st.floats(50, 200), st.floats(-0.01, 0.01), st.tuples(st.floats(-300, 300), st.floats(-300, 300))
)
def test_speed_is_that_of_the_boards_middle_however_it_turns(
    vx: float, vy: float, turn: float, about: tuple[float, float]
) -> None:
    times = np.array([0, 0.1, 0.25, 0.3, 0.4])
    belt = belt_speed(stitch_of(vx, vy, turn, about, times), times, (0.0, 100.0), np.asarray(about))
    assert belt.measured_mm_s == pytest.approx((vx, vy), abs=1e-9)
    assert belt.ratio == pytest.approx(np.hypot(vx, vy) / 100)


def test_stops_of_a_belt_with_an_encoder_do_not_count_as_its_speed(
    progress: Progress, make_head: Callable[[int], RecordingHead], make_stitch: Callable[..., Stitch]
) -> None:
    """The belt stood for 1 s between rows 1 and 2; the pictures show 1.01 times the way of the encoder."""
    head = make_head(4)
    progress.result = Concluded(make_stitch(head), "{}")
    measured = {"trigger_times_s": (0.0, 0.1, 1.2, 1.3), "belt_mm": (0.0, 10.0, 20.0, 30.0)}
    progress.recorded = RunFinished("r1", 1, head.model_copy(update=measured), (), 51.0, "clear")
    belt = detail_of(progress).belt
    assert belt is not None
    assert belt.ratio == pytest.approx(1.01)


def test_pulses_and_barrier_count_from_the_first_interruption(
    progress: Progress, make_head: Callable[[int], RecordingHead]
) -> None:
    head = make_head(2).model_copy(update={"trigger_times_s": (7.0, 7.11), "lights": ("left", "right")})
    progress.recorded = RunFinished("r1", 1, head, (), 51.0, "clear", interruptions=((-0.04, 0.3), (0.4, None)))
    found = timeline_of(progress)
    assert [(r.row, r.light) for r in found.rows] == [(0, "left"), (1, "right")]
    assert [r.pulse_s for r in found.rows] == pytest.approx([0.04, 0.15])
    assert {(r.exposure_us, r.led_us) for r in found.rows} == {(100.0, None)}
    assert [b.blocked_s for b in found.barrier] == pytest.approx([0.0, 0.44])
    assert found.barrier[1].clear_s is None
    progress.recorded = RunFinished("r1", 1, head, (), 51.0, "clear")
    assert timeline_of(progress).rows == (), "the barrier was not reported"

"""The belt as a board saw it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.model import Status, Stitch
from vaoi_station.runs.run.run_views import (
    belt_speed,
)


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

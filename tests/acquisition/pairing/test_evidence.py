"""What frame ids and time stamps show."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.pairing.evidence import (
    MAX_FRAME_ID,
    explain_missing,
    find_gaps,
    free_running_interval_s,
    id_step,
    in_counting_order,
    residuals_s,
)


@pytest.mark.parametrize(
    ("first", "second", "step"),
    [
        (1, 2, 1), (65535, 1, 1), (65534, 2, 3), (7, 7, 0), (9, 8, -1), (70000, 70002, 2),
        (65535, 65536, 1), (2**64 - 1, 1, 1), (2, 2**64 - 1, -2), (2**53 + 2, 2**53 + 1, -1),
    ],
)  # fmt: skip
def test_ids_wrap_from_their_largest_to_1(first: int, second: int, step: int) -> None:
    assert id_step(first, second) == step


def cause(row: int, ids: dict[int, int], unassigned: list[int], incomplete: frozenset[int] = frozenset()) -> str:
    """Return the cause of one row of six."""
    return explain_missing(row, set(ids), find_gaps(range(6), ids, incomplete, unassigned))


def test_the_cause_says_no_more_than_the_ids_show() -> None:
    assert "no frame in this run" in cause(0, {}, [])
    assert "first pulses" in cause(0, {1: 5}, [])
    assert "after the last" in cause(3, {1: 5}, [])
    assert "2 of 3 such pulses were; the frame ids do not show which" in cause(1, {0: 1, 4: 3}, [])
    assert "do not show how" in cause(1, {0: 1, 4: 9}, [])


@given(st.lists(st.booleans(), min_size=2, max_size=30), st.integers(1, MAX_FRAME_ID), st.data())
def test_exchanged_ids_are_sorted_across_the_wrap(arrived: list[bool], first: int, data: st.DataObject) -> None:
    rows = [row for row, there in enumerate(arrived) if there]
    right = {row: (first + row - 1) % MAX_FRAME_ID + 1 for row in rows}
    mixed = dict(zip(rows, data.draw(st.permutations([right[row] for row in rows])), strict=True))
    assert in_counting_order(mixed) == right


@given(st.data())
def test_a_fifth_of_outliers_is_found_and_does_not_move_the_line(data: st.DataObject) -> None:
    rows = data.draw(st.integers(10, 40))
    outliers = data.draw(st.sets(st.integers(0, rows - 1), max_size=rows // 5))
    drift, jitter_s = data.draw(st.floats(-2e-4, 2e-4)), 5e-6
    pulses = [row * 0.12 for row in range(rows)]
    late_s = [data.draw(st.floats(0.001, 0.01)) if n in outliers else 0.0 for n in range(rows)]
    camera = [p * (1 + drift) + data.draw(st.floats(0, jitter_s)) + s for p, s in zip(pulses, late_s, strict=True)]
    off = abs(residuals_s(pulses, camera))
    assert {n for n in range(rows) if off[n] > 200e-6} == outliers
    assert all(off[n] < 100e-6 for n in range(rows) if n not in outliers)


def test_a_free_running_camera_is_recognised_across_losses_and_the_wrap() -> None:
    assert free_running_interval_s([0.0, 0.033, 0.099], [65534, 65535, 2]) == pytest.approx(0.033)
    assert free_running_interval_s([0.0, 0.033, 0.08], [1, 2, 3]) is None
    assert free_running_interval_s([0.0, 0.033, 0.066], [1, 2, 2]) is None
    assert free_running_interval_s([0.0, 0.033], [1, 2]) is None

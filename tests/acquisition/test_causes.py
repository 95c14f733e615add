"""Causes in words, from the gaps in a camera's numbering."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.causes import WRAP, explain_missing, gaps, id_step, straightened


@pytest.mark.parametrize(
    ("first", "second", "step"), [(1, 2, 1), (65535, 1, 1), (65534, 2, 3), (7, 7, 0), (9, 8, -1), (70000, 70002, 2)]
)
def test_ids_wrap_from_65535_to_1(first: int, second: int, step: int) -> None:
    assert id_step(first, second) == step


def why(row: int, ids: dict[int, int], strays: list[int], torn: frozenset[int] = frozenset()) -> str:
    """Of one row of six."""
    return explain_missing(row, set(ids), gaps(range(6), ids, torn, strays))


def test_a_gap_in_the_ids_is_a_loss_on_the_way() -> None:
    assert "lost on the way" in why(1, {0: 65535, 2: 2}, [])


def test_no_gap_means_the_camera_did_not_expose() -> None:
    assert "did not expose" in why(1, {0: 10, 2: 11}, [])
    assert "did not expose" in why(2, {0: 10, 3: 11}, [])


def test_frames_nobody_asked_for_are_accounted_for() -> None:
    assert "did not expose" in why(1, {0: 10, 2: 12}, [11])


def test_frames_of_which_parts_came_were_exposed() -> None:
    assert "did not expose" in why(1, {0: 10, 3: 12}, [], frozenset({2}))
    assert "lost on the way" in why(1, {0: 10, 3: 13}, [], frozenset({2}))


def test_without_neighbours_less_is_said() -> None:
    assert "no frame in this run" in why(0, {}, [])
    assert "first pulses" in why(0, {1: 5}, [])
    assert "after the last" in why(3, {1: 5}, [])
    assert "2 of 3 such pulses were; its count does not tell which" in why(1, {0: 1, 4: 3}, [])
    assert "does not tell how" in why(1, {0: 1, 4: 9}, [])


def test_rows_that_were_not_fired_are_no_pulses() -> None:
    (gap,) = gaps([0, 1, 3], {1: 7, 3: 8}, frozenset(), [])
    assert (gap.pulses, gap.exposed, gap.missing, gap.ignored) == (1, 1, (), 0)


@given(st.lists(st.booleans(), min_size=2, max_size=30), st.integers(1, WRAP), st.data())
def test_exchanged_ids_are_put_straight_across_the_wrap(arrived: list[bool], first: int, data: st.DataObject) -> None:
    rows = [row for row, there in enumerate(arrived) if there]
    right = {row: (first + row - 1) % WRAP + 1 for row in rows}
    mixed = dict(zip(rows, data.draw(st.permutations([right[row] for row in rows])), strict=True))
    assert straightened(mixed) == right

"""Causes in words, from the gaps in a camera's numbering."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.causes import contradictions, explain_missing, id_step


@pytest.mark.parametrize(
    ("first", "second", "step"), [(1, 2, 1), (65535, 1, 1), (65534, 2, 3), (7, 7, 0), (9, 8, -1), (70000, 70002, 2)]
)
def test_ids_wrap_from_65535_to_1(first: int, second: int, step: int) -> None:
    assert id_step(first, second) == step


def test_a_gap_in_the_ids_is_a_loss_on_the_way() -> None:
    assert "lost on the way" in explain_missing(1, {0: 65535, 2: 2}, [])


def test_no_gap_means_the_camera_did_not_expose() -> None:
    assert "did not expose" in explain_missing(1, {0: 10, 2: 11}, [])


def test_frames_nobody_asked_for_are_accounted_for() -> None:
    assert "did not expose" in explain_missing(1, {0: 10, 2: 12}, [11])


def test_without_neighbours_less_is_said() -> None:
    assert "no frame in this run" in explain_missing(0, {}, [])
    assert "first pulses" in explain_missing(0, {1: 5}, [])
    assert "after the last" in explain_missing(3, {1: 5}, [])
    assert "does not tell" in explain_missing(1, {0: 1, 4: 3}, [])


def test_ids_that_do_not_fit_their_rows_are_noted() -> None:
    assert contradictions({0: 5, 1: 6, 3: 8}, []) == {}
    assert list(contradictions({0: 5, 1: 5}, [])) == [1]
    assert list(contradictions({0: 5, 1: 8}, [])) == [1]
    assert contradictions({0: 5, 1: 7}, [6]) == {}

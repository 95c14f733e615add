"""Computations in steps: their result, and what happens between the steps."""

from __future__ import annotations

import pytest

from vaoi_station.steps import Steps, completed


def counted(count: int) -> Steps[int]:
    for _ in range(count):
        yield
    return count


@pytest.mark.parametrize("count", [0, 1, 5])
def test_all_steps_give_the_result(count: int) -> None:
    assert completed(counted(count)) == count


def test_a_computation_stops_after_each_step() -> None:
    steps = counted(2)
    next(steps)
    next(steps)
    with pytest.raises(StopIteration) as end:
        next(steps)
    assert end.value.value == 2


def test_an_error_in_a_step_is_raised() -> None:
    def failing() -> Steps[int]:
        yield
        raise ValueError("a fault")

    with pytest.raises(ValueError, match="a fault"):
        completed(failing())

"""An encoder that stands still or counts backwards during a run is reported once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.hw.emulated.line import TIMING, ms
from vaoi_station.acquisition.controller.protocol import Pacing, State, Status
from vaoi_station.acquisition.controller.serial.controller import EncoderWatch

BELT = replace(TIMING, pacing=Pacing.DISTANCE)
RUNNING = replace(Status.unpack(bytes(48)), state=State.RUNNING, run=3, position=(1 << 32) - 50)


def codes(*steps: tuple[float, int], timing: object = BELT, **changes: int) -> list[str]:
    """Times in s and counts since the first status, each as a status; what was reported."""
    watch, found = EncoderWatch(), []
    for seconds, counts in steps:
        tick = ms(1000 * seconds) % (1 << 32)
        status = replace(RUNNING, tick=tick, position=(RUNNING.position + counts) % (1 << 32), **changes)
        error = watch.check(timing, status)  # type: ignore[arg-type]
        found += [error.code] if error is not None else []
    return found


def test_counts_that_arrive_are_no_fault() -> None:
    assert codes((0, 0), (4, 10), (8, 90), (12, 400)) == [], "also over the wrap of the counter"
    assert codes((0, 0), (4.9, 0), (5.0, 3), (9.0, 3)) == [], "a belt may stop for a while"


@pytest.mark.parametrize(("steps", "code"), [(((0, 0), (6, 0), (9, -3)), "silent"), (((0, 0), (1, -30)), "backwards")])
def test_a_fault_is_reported_once_in_a_run(steps: tuple[tuple[float, int], ...], code: str) -> None:
    assert codes(*steps, (20, steps[-1][1])) == [f"encoder-{code}"]


def test_only_runs_whose_rows_follow_the_belt_are_watched() -> None:
    still = ((0.0, 0), (9.0, 0))
    assert codes(*still, timing=TIMING) == []
    assert codes(*still, state=State.ARMED) == []


def test_the_next_run_begins_anew() -> None:
    watch = EncoderWatch()
    assert watch.check(BELT, RUNNING) is None
    assert watch.check(BELT, replace(RUNNING, run=4, tick=ms(9000))) is None
    error = watch.check(BELT, replace(RUNNING, run=4, tick=ms(15000)))
    assert error is not None
    assert "not counted for 6.0 s" in error.message

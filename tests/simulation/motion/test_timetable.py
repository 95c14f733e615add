from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.motion.timetable import EncoderTrack

Make = Callable[..., Twin]


@pytest.mark.parametrize("direction", [1, -1])
def test_the_board_s_front_meets_the_barrier_when_it_is_blocked(make: Make, direction: int) -> None:
    twin = make(belt={"direction": direction}, line={"barrier_mm": -10.0 * direction})
    passage = twin.passage(3)
    front, rear = (20.0, 0.0) if direction == 1 else (0.0, 20.0)
    assert passage.blocked_s == pytest.approx(twin.scenario.line.approach_s, abs=1e-6)
    assert apply(passage.pose(passage.blocked_s), (15.0, front))[1] == pytest.approx(-10 * direction, abs=1e-3)
    assert apply(passage.pose(passage.clear_s), (15.0, rear))[1] == pytest.approx(-10 * direction, abs=1e-3)


def test_a_stuck_board_blocks_until_the_largest_number_of_rows(make: Make) -> None:
    twin = make(faults={"stuck": [{"board": 1, "row": 1}]}, line={"longest_board_mm": 60.0})
    stuck, free = twin.passage(1), twin.passage(0)
    assert math.isinf(stuck.clear_s)
    assert stuck.faults.stuck == 1
    assert stuck.rows == twin.line.rows_of_longest_board > free.rows
    places = [stuck.pose(t) for t in stuck.pulse_times_s]
    assert not np.allclose(places[0], places[1])
    assert all(np.array_equal(places[1], p) for p in places[2:])
    assert np.array_equal(stuck.frame(0, 2), stuck.frame(0, 3))


def test_counts_of_the_encoder_lie_at_equal_distances() -> None:
    def halting(t_s: float) -> float:
        """100 mm/s, with a stop of half a second after one second."""
        return 100.0 * (min(t_s, 1.0) + max(t_s - 1.5, 0.0))

    track = EncoderTrack.of(halting, 2.0, 150.0)
    assert [halting(t) for t in track.steps_s] == pytest.approx(np.arange(1, 301) / 2, abs=0.06)
    assert track.counts_at(1.25) == pytest.approx(200, abs=1)
    assert [track.time_of(0), track.time_of(301)] == [0.0, math.inf]


def test_rows_keep_their_places_on_a_belt_that_changes_its_speed() -> None:
    changes = [{"at_s": 0.5, "for_s": 0.5, "factor": 0.5}, {"at_s": 1.2, "for_s": 0.3, "factor": 0.0}]
    line = {"encoder_counts_per_mm": 20.0, "longest_board_mm": 60.0, "period_s": 0.05}
    passage = Twin(Scenario.model_validate({"belt": {"changes": changes}, "line": line})).passage(0)
    ways = np.diff([passage.pose(t)[1, 2] for t in passage.pulse_times_s])
    assert ways == pytest.approx(5.0, abs=0.12), "the pulse follows its count by 1 ms"
    assert np.ptp(np.diff(passage.pulse_times_s)) > 0.04
    head = passage.head()
    assert head.belt_mm is not None
    assert head.belt_mm[:3] == (0.0, 5.0, 10.0)
    assert head.motion_times_s()[:3].tolist() == [0.0, 0.05, 0.1]
    assert Twin(Scenario()).passage(0).encoder is None

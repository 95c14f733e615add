"""Counts of the simulated belt: at equal distances of its way, however its speed changes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.motion.encoder import EncoderTrack, encoder_track


def halting(t_s: float) -> float:
    """100 mm/s, with a stop of half a second after one second."""
    return 100.0 * (min(t_s, 1.0) + max(t_s - 1.5, 0.0))


def test_counts_lie_at_equal_distances() -> None:
    track = encoder_track(halting, 2.0, 150.0)
    assert len(track.steps_s) == 300
    ways = np.array([halting(t) for t in track.steps_s])
    assert ways == pytest.approx(np.arange(1, 301) / 2, abs=0.06)
    assert track.counts_at(1.25) == pytest.approx(200, abs=1)


def test_a_count_and_its_time_belong_together() -> None:
    track = EncoderTrack(np.array([0.5, 0.75, 2.0]))
    assert [track.counts_at(t) for t in (0.0, 0.5, 1.0, 3.0)] == [0, 1, 2, 3]
    assert [track.time_of(n) for n in (0, 1, 3, 4)] == [0.0, 0.5, 2.0, math.inf]


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

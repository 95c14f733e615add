"""The simulation of the queue agrees with the formula for a queue that has one."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.plant.capacity import Requests, Waits, simulate


def test_a_queue_with_one_worker_waits_as_the_formula_says() -> None:
    """Pollaczek–Khinchine: with constant times s and load ρ the mean wait is ρ s / (2 (1 − ρ))."""
    waits = [simulate(Requests(1800, 1, 0), 1, [1.0], hours=4, seed=seed) for seed in range(3)]
    assert np.mean([w.busy for w in waits]) == pytest.approx(0.5, abs=0.02)
    assert np.mean([w.start_mean_s for w in waits]) == pytest.approx(0.5, rel=0.1)


def test_more_workers_end_a_request_sooner() -> None:
    one, four = (simulate(Requests(1, 1000), count, [1.0, 2.0], hours=20) for count in (1, 4))
    assert four.end_p50_s < one.end_p50_s / 3
    assert four.requests == one.requests, "equal seeds give equal requests"


def test_killed_workers_cost_the_work_of_their_run() -> None:
    calm, killed = (
        simulate(Requests(2, 500, 0), 4, [10.0], hours=20, killed_per_hour=rate, seed=3) for rate in (0.0, 36.0)
    )
    assert calm.lost_s == 0
    # A tenth of the runs is repeated after half of its time.
    assert killed.lost_s == pytest.approx(0.1 * 5.0 * 500 * killed.requests, rel=0.1)


def test_without_requests_nothing_happens() -> None:
    assert simulate(Requests(0, 10), 2, [1.0]) == Waits(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

"""Drift detection on made-up runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.watch import find_drifts, find_vanished_cameras

Made = Callable[..., RunCheck]
STILL = (0.0, 0.0, 0.0)


def test_scatter_is_no_drift(made: Made) -> None:
    g = np.random.default_rng(0)
    runs = [made(k, [tuple(g.normal(0, 0.02, 3)) for _ in range(6)]) for k in range(300)]
    assert not any(find_drifts(runs[:k]) for k in range(0, 301, 10))


def test_a_knock_is_reported_with_camera_size_and_first_run(made: Made) -> None:
    runs = [made(k, [STILL, STILL, STILL]) for k in range(6)]
    runs += [made(k, [STILL, (0.0, 30.0, 0.9), STILL]) for k in (6, 7)]
    assert find_drifts(runs[:7]) == (), "one odd board raises no alarm"
    (drift,) = find_drifts(runs)
    assert (drift.camera, drift.since_run, drift.since_time, drift.runs) == (1, "r006", "t006", 2)
    assert drift.displacement_px == pytest.approx((0.0, 30.0, 0.9))
    assert drift.size_px == pytest.approx(np.hypot(30.0, 0.9 / np.sqrt(3)))


def test_a_creeping_drift_is_reported_while_it_is_small(made: Made) -> None:
    runs = [made(k, [STILL, (0.01 * max(k - 8, 0), 0.0, 0.0), STILL]) for k in range(40)]
    alarm = next(k for k in range(41) if find_drifts(runs[:k]))
    assert runs[alarm - 1].cameras[1].x_px < 0.2
    (drift,) = find_drifts(runs[:alarm])
    assert drift.camera == 1


def blind(run: RunCheck, camera: int) -> RunCheck:
    cameras = list(run.cameras)
    cameras[camera] = cameras[camera].model_copy(update={"links": 2})
    return run.model_copy(update={"cameras": tuple(cameras)})


def test_a_camera_that_lost_its_neighbours_has_vanished(made: Made) -> None:
    runs = [made(k, [STILL, STILL, STILL]) for k in range(8)]
    after = [blind(made(k, [STILL, STILL, STILL]), 2) for k in range(8, 11)]
    assert find_vanished_cameras(runs) == ()
    assert find_vanished_cameras(runs + after[:2]) == ()
    assert find_vanished_cameras(runs + after) == (2,)
    assert find_drifts(runs + after) == ()
    assert find_vanished_cameras([*runs, *after, runs[0]]) == ()


def test_a_camera_that_small_boards_never_cover_has_not_vanished(made: Made) -> None:
    small = [blind(made(k, [STILL] * 3, board_type="small"), 2) for k in range(12)]
    large = [made(k, [STILL] * 3, board_type="large") for k in range(12)]
    assert find_vanished_cameras(small) == ()
    assert find_vanished_cameras([*large, *small]) == ()

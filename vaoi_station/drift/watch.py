"""The test for a drift: run after run, does a camera still look where it was calibrated?

Two cumulative sums (CUSUM; Page 1954) per number and camera, up and down, of deviations in standard deviations. One
odd board does not raise an alarm, two in a row that are far off do, and a creeping drift does within some runs.
What boards of a type always show (a board that lies a little higher, errors of the calibration) is taken out, as
far as it is small.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.displacement import PARAMETERS, size_px
from vaoi_station.geometry.robust import median_sigma
from vaoi_station.geometry.transforms import Floats

BASELINE_RUNS = 5
"""The first runs of a board type show its habits …"""
_HABIT_PX = 0.15
"""… and larger displacements (root of the sum of the three squares) are none."""
VANISHED_RUNS = 3
"""Boards in a row that tell nothing of a camera …"""
_USUALLY = 0.8
"""… though such a share of the boards before did."""
LEAST_PX = 0.05
"""Smaller drifts than this (rms over the frame) do not hurt."""
_FLOOR_PX = 0.02
"""What displacements scatter from board to board, beyond their standard deviations."""
_SLACK, _ALARM, _MOST = 0.5, 10.0, 6.0
"""Of the sums: what is forgiven in each run, what raises an alarm, and what one run may add."""
_CEILING = _ALARM + 3.0
"""So that a camera set right again is believed after some runs."""


@dataclass(frozen=True, eq=False)
class Drift:
    """A camera that no longer looks where it was calibrated."""

    camera: int
    displacement_px: tuple[float, float, float]
    """x, y, and turn at the corner: mean of the runs since."""
    size_px: float
    """Rms over the frame."""
    since: int
    """Number of the first run that shows it, among those looked at."""
    since_run: str
    since_time: str
    runs: int
    """Runs that show it."""
    instead: tuple[int, ...]
    """Cameras that may have moved in its place."""


def find_drifts(checks: Sequence[RunCheck]) -> tuple[Drift, ...]:
    """Drifts that hold at the end of these runs.

    Args:
        checks: runs under one calibration, oldest first.
    """
    if not checks:
        return ()
    d = np.array([[c.displacement_px for c in check.cameras] for check in checks])
    off = d - _habits(checks, d)
    seen = np.array([[c.seen for c in check.cameras] for check in checks])
    formal = np.array([[c.sigma_px for c in check.cameras] for check in checks])
    scatter = median_sigma(off[seen]) if seen.any() else 0.0
    z = off / np.sqrt(formal**2 + _FLOOR_PX**2 + scatter**2)
    found = [_drift(checks, d[:, i], seen[:, i], i, k) for i, k in _since(z, seen).items()]
    return tuple(drift for drift in found if drift.size_px >= LEAST_PX)


def find_vanished_cameras(checks: Sequence[RunCheck]) -> tuple[int, ...]:
    """Cameras of which the last boards tell nothing, though boards of their type used to: perhaps knocked far away.

    Args:
        checks: runs under one calibration, oldest first.
    """
    alike = [check for check in checks if check.board_type == checks[-1].board_type]
    seen = np.array([[camera.seen for camera in check.cameras] for check in alike])
    if len(seen) < VANISHED_RUNS + BASELINE_RUNS:
        return ()
    used_to = seen[:-VANISHED_RUNS].mean(0) >= _USUALLY
    return tuple(np.flatnonzero(used_to & ~seen[-VANISHED_RUNS:].any(0)).tolist())


def _habits(checks: Sequence[RunCheck], d: Floats) -> Floats:
    """What the first runs of each board type show, (runs, n, 3) px; more than a calibration may err is no habit."""
    by_type: dict[str, list[int]] = defaultdict(list)
    for k, check in enumerate(checks):
        by_type[check.board_type].append(k)
    habits = np.zeros_like(d)
    for at in by_type.values():
        usual = np.median(d[at[:BASELINE_RUNS]], axis=0)
        small = np.hypot.reduce(usual, axis=1, keepdims=True) <= _HABIT_PX
        habits[at] = np.where(small, usual, 0.0)
    return habits


def _since(z: Floats, seen: np.ndarray) -> dict[int, int]:
    """Cameras that are off at the end of the runs (runs, n, 3), and the run since which each is."""
    n = z.shape[1]
    sums, began = np.zeros((n, 2 * PARAMETERS)), np.zeros((n, 2 * PARAMETERS), dtype=np.int_)
    steps = np.clip(np.concatenate([z, -z], -1), -_MOST, _MOST) - _SLACK
    for k, step in enumerate(steps):
        here = seen[k][:, None]
        began = np.where(here & (sums <= 0), k, began)
        sums = np.where(here, np.clip(sums + step, 0, _CEILING), sums)
    alarmed = sums > _ALARM
    return {i: int(began[i][alarmed[i]].min()) for i in np.flatnonzero(alarmed.any(1)).tolist()}


def _drift(checks: Sequence[RunCheck], d: Floats, seen: np.ndarray, camera: int, since: int) -> Drift:
    at = since + np.flatnonzero(seen[since:])
    middle = np.median(d[at], axis=0)
    x, y, turn = (float(v) for v in middle)
    return Drift(
        camera,
        (x, y, turn),
        size_px(middle),
        since,
        checks[since].run,
        checks[since].time,
        len(at),
        checks[-1].rivals,
    )

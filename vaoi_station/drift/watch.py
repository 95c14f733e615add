"""Drift detection: the test for cameras that have moved since their calibration, over a sequence of runs.

Two cumulative sums (CUSUM; Page 1954) per number and camera, up and down, of deviations in standard deviations. One odd
board raises no alarm; two in a row that are far off do, and so does a creeping drift within some runs. What boards of a
type always show (a board that lies a little higher, errors of the calibration) is subtracted as long as it is small.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.displacement import PARAMETERS, rms_displacement_px
from vaoi_station.geometry.robust import median_sigma
from vaoi_station.geometry.transforms import Floats

BASELINE_RUNS = 5
"""Number of first runs of a board type that give its baseline, its usual displacements."""
_BASELINE_PX = 0.15
"""Largest displacement (root of the sum of the three squares) that counts as baseline and not as a move."""
VANISHED_RUNS = 3
"""Number of boards in a row that do not show a camera before it counts as vanished."""
_USUALLY = 0.8
"""Least share of the boards before that showed it."""
LEAST_PX = 0.05
"""Smallest drift (rms over the frame) that is reported; smaller ones do no harm."""
_FLOOR_PX = 0.02
"""Scatter of displacements from board to board, beyond their standard deviations."""
_SLACK, _ALARM, _MOST = 0.5, 10.0, 6.0
"""Of the sums: subtracted in each run, level of an alarm, and largest contribution of one run."""
_CEILING = _ALARM + 3.0
"""Ceiling of the sums, so that a camera that was set right is cleared after some runs."""


@dataclass(frozen=True, eq=False)
class Drift:
    """A camera that has moved since its calibration."""

    camera: int
    displacement_px: tuple[float, float, float]
    """x, y, and turn at the corner: mean of the runs since."""
    size_px: float
    """Motion of the picture, rms over the frame."""
    since: int
    """Index of the first run that shows it, among the runs given."""
    since_run: str
    since_time: str
    runs: int
    """Number of runs that show it."""
    instead: tuple[int, ...]
    """Cameras that may have moved in its place."""


def find_drifts(checks: Sequence[RunCheck]) -> tuple[Drift, ...]:
    """Find the drifts that hold at the end of these runs.

    Args:
        checks: runs under one calibration, oldest first.
    """
    if not checks:
        return ()
    d = np.array([[c.displacement_px for c in check.cameras] for check in checks])
    off = d - _baselines(checks, d)
    seen = np.array([[c.seen for c in check.cameras] for check in checks])
    formal = np.array([[c.sigma_px for c in check.cameras] for check in checks])
    # The scatter of this line is measured, since boards differ more than their standard deviations say.
    scatter = median_sigma(off[seen]) if seen.any() else 0.0
    z = off / np.sqrt(formal**2 + _FLOOR_PX**2 + scatter**2)
    found = [_drift(checks, d[:, i], seen[:, i], i, k) for i, k in _alarms(z, seen).items()]
    return tuple(drift for drift in found if drift.size_px >= LEAST_PX)


def find_vanished_cameras(checks: Sequence[RunCheck]) -> tuple[int, ...]:
    """Find cameras that the last boards do not show although boards of their type usually do.

    Such a camera was perhaps knocked so far that it shares nothing with its neighbours.

    Args:
        checks: runs under one calibration, oldest first.
    """
    alike = [check for check in checks if check.board_type == checks[-1].board_type]
    seen = np.array([[camera.seen for camera in check.cameras] for check in alike])
    if len(seen) < VANISHED_RUNS + BASELINE_RUNS:
        return ()
    used_to = seen[:-VANISHED_RUNS].mean(0) >= _USUALLY
    return tuple(np.flatnonzero(used_to & ~seen[-VANISHED_RUNS:].any(0)).tolist())


def _baselines(checks: Sequence[RunCheck], d: Floats) -> Floats:
    """Compute the baseline of every run, (runs, n, 3) px: the median of the first runs of its board type."""
    by_type: dict[str, list[int]] = defaultdict(list)
    for k, check in enumerate(checks):
        by_type[check.board_type].append(k)
    baselines = np.zeros_like(d)
    for at in by_type.values():
        usual = np.median(d[at[:BASELINE_RUNS]], axis=0)
        # A camera that was knocked before the first run shows a large usual displacement: that one is reported.
        small = np.hypot.reduce(usual, axis=1, keepdims=True) <= _BASELINE_PX
        baselines[at] = np.where(small, usual, 0.0)
    return baselines


def _alarms(z: Floats, seen: np.ndarray) -> dict[int, int]:
    """Find cameras in alarm at the end of the runs (runs, n, 3), each with the index of its first run."""
    n = z.shape[1]
    sums, began = np.zeros((n, 2 * PARAMETERS)), np.zeros((n, 2 * PARAMETERS), dtype=np.int_)
    # Clipped, so that one odd board (lifted, or badly linked) never raises the alarm alone.
    steps = np.clip(np.concatenate([z, -z], -1), -_MOST, _MOST) - _SLACK
    for k, step in enumerate(steps):
        # A run that does not show a camera leaves its sums as they are.
        here = seen[k][:, None]
        began = np.where(here & (sums <= 0), k, began)
        sums = np.where(here, np.clip(sums + step, 0, _CEILING), sums)
    alarmed = sums > _ALARM
    return {i: int(began[i][alarmed[i]].min()) for i in np.flatnonzero(alarmed.any(1)).tolist()}


def _drift(checks: Sequence[RunCheck], d: Floats, seen: np.ndarray, camera: int, since: int) -> Drift:
    at = since + np.flatnonzero(seen[since:])
    # Reported as measured, without the baseline: `vaoi recalibrate` corrects the whole displacement.
    middle = np.median(d[at], axis=0)
    x, y, turn = (float(v) for v in middle)
    return Drift(
        camera,
        (x, y, turn),
        rms_displacement_px(middle),
        since,
        checks[since].run,
        checks[since].time,
        len(at),
        checks[-1].rivals,
    )

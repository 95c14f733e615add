"""Drift detection: a statistical test, over a sequence of runs, for cameras that have moved since their calibration.

For each camera and each of x, y and turn there are two cumulative sums (CUSUM; Page 1954), one of upward and one of
downward deviations, in standard deviations. One unusual board raises no alarm. Two boards in a row with large
deviations raise an alarm, and a slow drift raises it after some runs. The baseline of each board type (its usual
displacements) is subtracted first, if it is small. It comes from boards that always lie a little higher, or from small
errors of the calibration.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.checks import RunCheck
from vaoi_station.geometry.displacement import PARAMETERS, rms_displacement_px
from vaoi_station.geometry.robust import median_sigma
from vaoi_station.geometry.transforms import Floats

BASELINE_RUNS = 5
"""Number of first runs of a board type from which its baseline (its usual displacements) is computed."""
_BASELINE_PX = 0.15
"""Largest length of the vector (x, y, turn) of a baseline. If it is longer, the camera has moved."""
VANISHED_RUNS = 3
"""Number of consecutive boards without evidence of a camera after which the camera counts as vanished."""
_USUALLY = 0.8
"""Least share of the earlier boards that must have shown a camera before it can count as vanished."""
LEAST_PX = 0.05
"""Smallest drift that is reported, px rms over the frame. Smaller drifts have no effect that matters."""
_FLOOR_PX = 0.02
"""Scatter of displacements from board to board, in addition to their estimated standard deviations."""
_SLACK, _ALARM, _MOST = 0.5, 10.0, 6.0
"""Parameters of the cumulative sums: amount subtracted in each run, alarm level, largest deviation that a run adds."""
_CEILING = _ALARM + 3.0
"""Largest value of a cumulative sum. It is limited so that the alarm ends soon after a camera is corrected."""


@dataclass(frozen=True, eq=False)
class Drift:
    """A camera that has moved since its calibration."""

    camera: int
    displacement_px: tuple[float, float, float]
    """Displacement x, y and turn, px, as the median of the runs since the drift began."""
    size_px: float
    """Motion of the picture by the displacement, rms over the frame."""
    since: int
    """Index, in the given list of runs, of the first run that shows the drift."""
    since_run: str
    since_time: str
    runs: int
    """Number of runs, since the drift began, that show the camera."""
    instead: tuple[int, ...]
    """Cameras that may have moved instead of this one."""


def find_drifts(checks: Sequence[RunCheck]) -> tuple[Drift, ...]:
    """Find the drifts that are present at the end of a sequence of runs.

    Args:
        checks: checks of runs under one calibration, oldest first.
    """
    if not checks:
        return ()
    d = np.array([[c.displacement_px for c in check.cameras] for check in checks])
    off = d - _baselines(checks, d)
    seen = np.array([[c.seen for c in check.cameras] for check in checks])
    formal = np.array([[c.sigma_px for c in check.cameras] for check in checks])
    # The scatter is measured from run to run, since boards differ more than the estimated standard deviations predict.
    scatter = median_sigma(off[seen]) if seen.any() else 0.0
    z = off / np.sqrt(formal**2 + _FLOOR_PX**2 + scatter**2)
    found = [_drift(checks, d[:, i], seen[:, i], i, k) for i, k in _alarms(z, seen).items()]
    return tuple(drift for drift in found if drift.size_px >= LEAST_PX)


def find_vanished_cameras(checks: Sequence[RunCheck]) -> tuple[int, ...]:
    """Find cameras that the last boards do not show although earlier boards of the same type usually did.

    Such a camera was perhaps knocked so far that its view no longer overlaps with those of its neighbours.

    Args:
        checks: checks of runs under one calibration, oldest first.
    """
    alike = [check for check in checks if check.board_type == checks[-1].board_type]
    seen = np.array([[camera.seen for camera in check.cameras] for check in alike])
    if len(seen) < VANISHED_RUNS + BASELINE_RUNS:
        return ()
    used_to = seen[:-VANISHED_RUNS].mean(0) >= _USUALLY
    return tuple(np.flatnonzero(used_to & ~seen[-VANISHED_RUNS:].any(0)).tolist())


def _baselines(checks: Sequence[RunCheck], d: Floats) -> Floats:
    """Compute for every run the baseline of its board type: (runs, n, 3) px for n cameras.

    The baseline is the median displacement of the first runs of the board type; zero for a camera where it is large.
    """
    by_type: dict[str, list[int]] = defaultdict(list)
    for k, check in enumerate(checks):
        by_type[check.board_type].append(k)
    baselines = np.zeros_like(d)
    for at in by_type.values():
        usual = np.median(d[at[:BASELINE_RUNS]], axis=0)
        # A camera that was knocked before the first run has a large baseline. It is reported, not subtracted.
        small = np.hypot.reduce(usual, axis=1, keepdims=True) <= _BASELINE_PX
        baselines[at] = np.where(small, usual, 0.0)
    return baselines


def _alarms(z: Floats, seen: np.ndarray) -> dict[int, int]:
    """Find the cameras in alarm at the end of the runs, each with the index of the run in which its drift began.

    Args:
        z: (runs, n, 3) deviations of n cameras from the baseline, in standard deviations.
        seen: (runs, n) whether each run shows each camera.
    """
    n = z.shape[1]
    sums, began = np.zeros((n, 2 * PARAMETERS)), np.zeros((n, 2 * PARAMETERS), dtype=np.int_)
    # Deviations are clipped, so that one unusual board (lifted, or badly linked) never raises the alarm alone.
    steps = np.clip(np.concatenate([z, -z], -1), -_MOST, _MOST) - _SLACK
    for k, step in enumerate(steps):
        # A run that does not show a camera leaves the sums of this camera as they are.
        here = seen[k][:, None]
        began = np.where(here & (sums <= 0), k, began)
        sums = np.where(here, np.clip(sums + step, 0, _CEILING), sums)
    alarmed = sums > _ALARM
    return {i: int(began[i][alarmed[i]].min()) for i in np.flatnonzero(alarmed.any(1)).tolist()}


def _drift(checks: Sequence[RunCheck], d: Floats, seen: np.ndarray, camera: int, since: int) -> Drift:
    at = since + np.flatnonzero(seen[since:])
    # The whole measured displacement is reported, baseline included, because `vaoi recalibrate` corrects all of it.
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

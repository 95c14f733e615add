"""Whether a series grows: Theil–Sen slopes with an interval of confidence that takes correlation into account.

The series of one process is a sequence of lives: a process that was killed begins anew. Pairs of samples are formed
within lives only, as the seasonal Kendall test does with seasons (Hirsch, Slack and Smith 1982). The variance of
Kendall's S is corrected for serial correlation as in Hamed and Rao (1998); the interval is Sen's (1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Z_99 = 2.575829
"""Quantile of the normal distribution for a two-sided interval of 99 %."""
BLOCKS = 120
"""Most blocks of a life; each is reduced to its median, which outliers do not change."""
LEAST_BLOCKS = 8
"""Fewest blocks of a life from which a slope follows."""
WARM_UP = 60
"""Fewest first boards of a life that are left out, and at least half of it: caches, pools and the database fill up."""
Array = NDArray[np.float64]


class Slope(NamedTuple):
    """A slope per board with its interval of confidence (99 %)."""

    per_board: float
    low: float
    high: float
    median: float
    boards: int
    """Boards in all lives that were used."""
    span: float
    """Largest minus smallest median of a block, over all lives."""

    @property
    def flat(self) -> bool:
        """Whether the slope is indistinguishable from zero."""
        return self.low <= 0.0 <= self.high


def slope_of(lives: Sequence[tuple[Array, Array]], warm_up: int = WARM_UP) -> Slope | None:
    """Return the common slope of several lives, each (boards, values); None if they are too short."""
    late = [(x[max(warm_up, len(x) // 2) :], y[max(warm_up, len(x) // 2) :]) for x, y in lives]
    used = [block_medians(x, y) for x, y in late if len(x) >= LEAST_BLOCKS]
    if not used:
        return None
    slopes = np.sort(np.concatenate([_pair_slopes(x, y) for x, y in used]))
    variance = sum(_kendall_variance(y, x, float(np.median(slopes))) for x, y in used)
    # Sen's interval: the slopes whose ranks lie z·σ(S)/2 around the middle one.
    reach = Z_99 * np.sqrt(variance) / 2
    middle = (len(slopes) - 1) / 2
    low = int(max(np.floor(middle - reach), 0))
    high = int(min(np.ceil(middle + reach), len(slopes) - 1))
    values = np.concatenate([y for _, y in used])
    return Slope(
        float(np.median(slopes)),
        float(slopes[low]),
        float(slopes[high]),
        float(np.median(values)),
        sum(len(x) for x, _ in late if len(x) >= LEAST_BLOCKS),
        max(float(np.ptp(y)) for _, y in used),
    )


def block_medians(x: Array, y: Array) -> tuple[Array, Array]:
    """Reduce a series to the medians of at most `BLOCKS` blocks of equal length."""
    blocks = min(BLOCKS, max(LEAST_BLOCKS, len(x) // 5))
    parts = np.array_split(np.arange(len(x)), min(blocks, len(x)))
    return np.array([x[p].mean() for p in parts]), np.array([np.median(y[p]) for p in parts])


def _pair_slopes(x: Array, y: Array) -> Array:
    i, j = np.triu_indices(len(x), 1)
    return (y[j] - y[i]) / (x[j] - x[i])


def _kendall_variance(y: Array, x: Array, slope: float) -> float:
    """Return the variance of Kendall's S without a trend, larger by the serial correlation of the ranks."""
    n = len(y)
    ranks = np.argsort(np.argsort(y - slope * x, kind="stable"), kind="stable").astype(float)
    ranks -= ranks.mean()
    power = float(ranks @ ranks)
    lags = np.arange(1, n - 2)
    correlation = np.array([float(ranks[k:] @ ranks[:-k]) / power for k in lags])
    # Behind the first lag without correlation there is only noise.
    if (ends := np.flatnonzero(correlation <= 0)).size:
        correlation[ends[0] :] = 0.0
    weights = (n - lags) * (n - lags - 1.0) * (n - lags - 2.0)
    inflation = 1 + 2 / (n * (n - 1.0) * (n - 2.0)) * float(weights @ correlation)
    return n * (n - 1) * (2 * n + 5) / 18 * max(inflation, 1.0)

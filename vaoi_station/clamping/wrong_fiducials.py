"""Which readings are of the fiducials that they name: the most that a rigid motion explains, by pairs.

All pairs of readings are tried, each as every pair of fiducials of the same distance: so a swap, a board that lies
turned, or a reading of another fiducial is not only noticed but named.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
_SIGMAS, _LEAST_MM = 5.0, 0.01
"""Distance at which a reading is that of a fiducial, in standard deviations, and what is always granted."""
_MOST_PAIRS, _MOST_STARTS = 200, 2000
"""Pairs of readings, the farthest first, and pairs of fiducials for them, that are tried."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """Which fiducial each reading is of, by number; −1: of none."""

    of: Ints
    turn_rad: float
    """Angle of the axis x as filmed in the tester's coordinates."""

    @property
    def explained(self) -> int:
        """Number of readings that are of a fiducial."""
        return int((self.of >= 0).sum())


def assignments(
    fiducials: Floats, read: Floats, named: Ints, sigma: Floats, ppm: float, *, mirrored: bool
) -> tuple[Assignment, list[Assignment]]:
    """Return the best assignment as the readings are named, and those with other names that explain as many or more.

    Args:
        fiducials: (f, 2) places as filmed, mm.
        read: (k, 2) readings, mm, k ≥ 2.
        named: (k,) the fiducial that each names.
        sigma: (k,) standard deviation of each, with that of its place.
        ppm: how far the scales may differ, in millionths.
        mirrored: whether the tester's coordinates are mirrored against those of the film.
    """
    place, seen = fiducials @ (1, -1j if mirrored else 1j), read @ (1, 1j)
    apart = np.abs(place[:, None] - place)

    def explained(i: int, j: int, m: int, n: int) -> tuple[Floats, Floats, float]:
        """Return how far each reading is from each fiducial, and how far it may be, if `i`, `j` are of `m`, `n`."""
        turn = (seen[j] - seen[i]) / (place[n] - place[m])
        turn /= abs(turn)
        middle = (seen[i] + seen[j]) / 2
        expected = middle + turn * (place - (place[m] + place[n]) / 2)
        reach = _LEAST_MM + _SIGMAS * (2 * sigma + ppm * 1e-6 * np.abs(seen - middle))
        return np.abs(seen[:, None] - expected), reach, float(np.angle(turn))

    each = [(i, j) for i, j in combinations(range(len(seen)), 2) if abs(seen[i] - seen[j]) > _LEAST_MM]
    pairs = sorted(each, key=lambda ij: -abs(seen[ij[0]] - seen[ij[1]]))[:_MOST_PAIRS]
    granted = [
        _LEAST_MM + _SIGMAS * (float(np.hypot(sigma[i], sigma[j])) + ppm * 1e-6 * abs(seen[i] - seen[j]))
        for i, j in pairs
    ]
    best, every = Assignment(np.full(len(seen), -1), 0.0), np.arange(len(seen))
    for (i, j), most in zip(pairs, granted, strict=True):
        m, n = named[i], named[j]
        if abs(apart[m, n] - abs(seen[i] - seen[j])) <= most:
            off, reach, turn = explained(i, j, m, n)
            found = Assignment(np.where(off[every, named] <= reach, named, -1), turn)
            best = max(best, found, key=lambda a: a.explained)
        if best.explained == len(seen):
            pairs = pairs[:1]  # Other names must explain all readings too, and so these two.
            break
    others, starts = dict[tuple[int, ...], Assignment](), 0
    for (i, j), most in zip(pairs, granted, strict=False):
        alike = np.argwhere((np.abs(apart - abs(seen[i] - seen[j])) <= most) & (apart > 0)).tolist()
        for m, n in alike[: max(_MOST_STARTS - starts, 0)]:
            off, reach, turn = explained(i, j, m, n)
            of = np.where(off.min(1) <= reach, off.argmin(1), -1)
            once = np.bincount(of[of >= 0]).max(initial=0) == 1
            if once and (of >= 0).sum() >= max(best.explained, 2) and ((of != named) & (of >= 0)).any():
                others.setdefault(tuple(of.tolist()), Assignment(of, turn))
        starts += len(alike)
    return best, sorted(others.values(), key=lambda a: -a.explained)

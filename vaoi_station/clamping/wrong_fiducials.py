"""Which readings are of the fiducials that they name: the most that a rigid motion explains, by pairs.

All pairs of readings are tried, each as every pair of fiducials of the same distance: so a swap, a board that lies
turned, or a reading of another fiducial is not only noticed but named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

Ints = NDArray[np.int_]
_SIGMAS, _LEAST_MM = 5.0, 0.01
"""Distance at which a reading is that of a fiducial, in standard deviations, and what is always granted."""
_MOST_PAIRS, _MOST_STARTS = 200, 2000
"""Pairs of readings, the farthest first, and pairs of fiducials for them, that are tried."""
_OUTERMOST, _MOST_DISTANCES = 8, 2_500_000
"""Readings by which most pairs of fiducials are excluded, and distances that are computed for the others."""


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
    apart, count = np.abs(place[:, None] - place), len(seen)

    def as_filmed(starts: Ints, which: Ints) -> tuple[NDArray[np.complex128], Floats]:
        """Return readings (s, k) among the places as filmed, and how far from one they may be, by each start.

        A start (i, j, m, n) is that the readings i, j are of the fiducials m, n.
        """
        i, j, m, n = starts.T
        arm = seen[which] - ((seen[i] + seen[j]) / 2)[:, None]
        reach = _LEAST_MM + _SIGMAS * (2 * sigma[which] + ppm * 1e-6 * np.abs(arm))
        back = arm / turns(starts)[:, None] + ((place[m] + place[n]) / 2)[:, None]
        return back, reach

    def turns(starts: Ints) -> NDArray[np.complex128]:
        i, j, m, n = starts.T
        turn = (seen[j] - seen[i]) / (place[n] - place[m])
        return np.asarray(turn / np.abs(turn))

    i, j = np.triu_indices(count, 1)
    between = np.abs(seen[i] - seen[j])
    far = np.argsort(-between, kind="stable")[:_MOST_PAIRS]
    far = far[between[far] > _LEAST_MM]
    i, j, between = i[far], j[far], between[far]
    granted = _LEAST_MM + _SIGMAS * (np.hypot(sigma[i], sigma[j]) + ppm * 1e-6 * between)
    best, every = Assignment(np.full(count, -1), 0.0), np.arange(count)
    own = apart[named[i], named[j]]
    starts = np.stack([i, j, named[i], named[j]], 1)[(np.abs(own - between) <= granted) & (own > 0)]
    if len(starts):
        back, reach = as_filmed(starts, every)
        fits = np.abs(back - place[named]) <= reach
        first = int(fits.sum(1).argmax())
        best = Assignment(np.where(fits[first], named, -1), float(np.angle(turns(starts[first : first + 1])[0])))
    if best.explained == count:
        i, j = i[:1], j[:1]  # Other names must explain all readings too, and so these two.
    starts = _alike(apart, i, j, between, granted)
    # Most starts are excluded by the outermost readings; only the others are compared with all.
    least, outermost = max(best.explained, 2), np.argsort(-np.abs(seen - seen.mean()), kind="stable")[:_OUTERMOST]
    others = dict[tuple[int, ...], Assignment]()
    for which in (outermost, every):
        starts = starts[: max(_MOST_DISTANCES // (len(which) * len(place)), 1)]
        back, reach = as_filmed(starts, which)
        off = np.abs(back[:, :, None] - place)
        near = off.min(2) <= reach
        good = near.sum(1) >= least - (count - len(which))
        starts, near, of = starts[good], near[good], off[good].argmin(2)
    for is_near, numbers, turn in zip(near, of, turns(starts), strict=True):
        found = np.where(is_near, numbers, -1)
        once = np.bincount(found[is_near]).max(initial=0) == 1
        if once and (found != named)[is_near].any():
            others.setdefault(tuple(found.tolist()), Assignment(found, float(np.angle(turn))))
    return best, sorted(others.values(), key=lambda a: -a.explained)


def _alike(apart: Floats, i: Ints, j: Ints, between: Floats, granted: Floats) -> Ints:
    """Return the starts (s, 4): pairs of readings, each with all pairs of fiducials that are as far apart."""
    order = np.argsort(apart, axis=None, kind="stable")
    far = apart.ravel()[order]
    out, total = [np.zeros((0, 4), np.int_)], 0
    for a, b, d, most in zip(i, j, between, granted, strict=False):
        low, high = np.searchsorted(far, (max(d - most, 1e-9), d + most), "left")
        m, n = divmod(np.sort(order[low:high])[: _MOST_STARTS - total], len(apart))
        out.append(np.stack([np.full(len(m), a), np.full(len(m), b), m, n], 1))
        total += len(m)
        if total >= _MOST_STARTS:
            break
    return np.concatenate(out)

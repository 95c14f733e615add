"""Estimate a first row motion, accurate to a pixel, from the median shift of the links between rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Observations

_LEAST_LINKS = 3
"""Least number of links that connect two rows."""


def chain_links(nominal: Motion, links: Observations) -> Motion:
    """Estimate the shift of every row from the median of its links to the latest earlier row.

    A row without such links moves from the row before as in the nominal motion. A median is taken over the links of all
    cameras, so that a single frame with tall parts or reflections has little influence.
    """
    shift = nominal.shift.copy()
    rows = len(shift)
    by_pair = np.argsort(links.q * rows + links.p, kind="stable")
    p, q = links.p[by_pair], links.q[by_pair]
    for row in range(1, rows):
        first, last = np.searchsorted(q, (row, row + 1))
        # links between two cameras have p = q = row and are left out
        last = first + np.searchsorted(p[first:last], row)
        if last > first:
            # Only links to the latest earlier row are used: errors grow with the distance between the rows.
            latest = by_pair[first + np.searchsorted(p[first:last], p[last - 1]) : last]
            step = links.a_mm[latest] - links.b_mm[latest]
            shift[row] = shift[p[last - 1]] + np.median(step, axis=0)
        else:
            shift[row] = shift[row - 1] + nominal.shift[row] - nominal.shift[row - 1]
    return replace(nominal, shift=shift)


def connected_rows(links: Observations, rows: int, used: np.ndarray) -> list[np.ndarray]:
    """Return the groups of rows that are connected by links, as arrays of row indices. A complete run has one group.

    `rows` is the number of rows; `used` selects the links that count. Of a pair of rows, at least `_LEAST_LINKS` count:
    fewer always fit some motion, so that false ones would connect the rows.
    """
    label = np.arange(rows)
    pairs, count = np.unique(links.p[used] * rows + links.q[used], return_counts=True)
    for pair in pairs[count >= _LEAST_LINKS]:
        a, b = label[pair // rows], label[pair % rows]
        label[label == max(a, b)] = min(a, b)
    return [np.flatnonzero(label == k) for k in np.unique(label)]

"""A first motion, good to a pixel: the medians of the links, chained over the rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vaoi_station.stitching.motion import Motion
from vaoi_station.stitching.observations import Observations


def chained(nominal: Motion, links: Observations) -> Motion:
    """Nominal motion, corrected row by row by the median of the links that lead there.

    Medians over all cameras: a frame full of tall parts or reflections is outvoted by its row.
    """
    shift = nominal.shift.copy()
    step = links.a_mm - links.b_mm
    for q in range(1, len(shift)):
        onto = links.q == q
        earlier = links.p[onto & (links.p < q)]
        if len(earlier):
            p = int(earlier.max())
            use = onto & (links.p == p)
            shift[q] = shift[p] + np.median(step[use], axis=0)
        else:
            shift[q] = shift[q - 1] + nominal.shift[q] - nominal.shift[q - 1]
    return replace(nominal, shift=shift)


def tied_rows(links: Observations, rows: int, used: np.ndarray) -> list[np.ndarray]:
    """Rows that links tie to one another, as groups; a run in one piece has one group."""
    label = np.arange(rows)
    for pair in np.unique(links.p[used] * rows + links.q[used]):
        a, b = label[pair // rows], label[pair % rows]
        label[label == max(a, b)] = min(a, b)
    return [np.flatnonzero(label == k) for k in np.unique(label)]

"""The similarity C as four numbers (a, b, x, y): board = [a −b; b a]·cad + (x, y)."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.transforms import Floats


def apply_similarity(c: Floats, cad: Floats) -> Floats:
    """Return the board points of CAD points (k, 2) under the similarity (a, b, x, y)."""
    a, b, x, y = c
    return np.stack([a * cad[:, 0] - b * cad[:, 1] + x, b * cad[:, 0] + a * cad[:, 1] + y], -1)


def similarity_jacobian(cad: Floats) -> Floats:
    """Return the derivative (k, 2, 4) of `apply_similarity` by (a, b, x, y)."""
    x, y, one, nil = cad[:, 0], cad[:, 1], np.ones(len(cad)), np.zeros(len(cad))
    return np.stack([np.stack([x, -y, one, nil], -1), np.stack([y, x, nil, one], -1)], 1)

"""Compiled resampling of a frame on a mesh of exactly projected nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats

_STEPS = 64


def _table() -> Floats:
    """Compute the weights (65, 6) of Lanczos' kernel of three lobes at fractions of a pixel; their sums are 1."""
    x = np.arange(-2, 4)[None] - np.arange(_STEPS + 2)[:, None] / _STEPS
    weights = np.sinc(x) * np.sinc(x / 3) * (np.abs(x) < 3)
    return np.asarray(weights / weights.sum(1, keepdims=True))


_TABLE = _table()


@compiled
def sample(image: NDArray[Any], nodes: Floats, step: int, out: NDArray[np.float32]) -> None:
    """Sample an image with a windowed sinc of 6×6 pixels and write the values to `out` (h, w); NaN outside the image.

    A narrower kernel displaces fine texture, by up to 0.02 px for waves of 5 px, and alike in a whole small part.

    Args:
        image: (rows, columns) grey levels.
        nodes: (ny, nx, 2) positions in the image of every `step`-th pixel of `out`; between them they are bilinear.
        step: distance of the nodes in pixels of `out`.
        out: output.
    """
    rows, columns = image.shape
    wx, wy = np.empty(6), np.empty(6)
    for y in range(out.shape[0]):
        a = y // step
        ty = (y - a * step) / step
        if a + 1 >= nodes.shape[0]:
            a, ty = nodes.shape[0] - 2, 1.0
        for x in range(out.shape[1]):
            b = x // step
            tx = (x - b * step) / step
            if b + 1 >= nodes.shape[1]:
                b, tx = nodes.shape[1] - 2, 1.0
            u = (1 - ty) * ((1 - tx) * nodes[a, b, 0] + tx * nodes[a, b + 1, 0]) + ty * (
                (1 - tx) * nodes[a + 1, b, 0] + tx * nodes[a + 1, b + 1, 0]
            )
            v = (1 - ty) * ((1 - tx) * nodes[a, b, 1] + tx * nodes[a, b + 1, 1]) + ty * (
                (1 - tx) * nodes[a + 1, b, 1] + tx * nodes[a + 1, b + 1, 1]
            )
            if not (u >= 2 and v >= 2 and u < columns - 3 and v < rows - 3):
                out[y, x] = np.nan
                continue
            left, top = int(u), int(v)
            _weights(u - left, wx)
            _weights(v - top, wy)
            total = 0.0
            for j in range(6):
                line = image[top - 2 + j]
                part = 0.0
                for i in range(6):
                    part += wx[i] * line[left - 2 + i]
                total += wy[j] * part
            out[y, x] = total


@inlined
def _weights(t: float, weights: Floats) -> None:
    """Write the weights of the six nearest samples, t after the third one, to `weights`."""
    at = t * _STEPS
    n = int(at)
    rest = at - n
    for k in range(6):
        weights[k] = _TABLE[n, k] + rest * (_TABLE[n + 1, k] - _TABLE[n, k])

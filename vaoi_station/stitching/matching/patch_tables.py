"""Sizes of a patch, and the weights of its blur and of the interpolation: constants of `refine`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW_PX = 24
"""Side of the patch that is compared: three vector registers of eight."""
PITCH_PX = 32
"""From line to line of a patch or tile in memory: loops run over all lines at once, and what fills a line up is nil."""
BINOMIAL = (20, 15, 6, 1)
"""Weights of the blur in 64ths, from the middle outwards: like a Gaussian of 1.22 px, but in whole numbers, and
nothing is left of what changes from pixel to pixel."""
BLUR_REACH = 3
TAPS = 6
FRACTIONS = 512
"""Steps of a pixel in the table of the interpolation; between them its weights are linear."""
_KAISER = 6.0

_Table = NDArray[np.float32]


def _sinc() -> _Table:
    f = np.linspace(0, 1, FRACTIONS + 1)
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1) - f[:, None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(1, keepdims=True), dtype=np.float32)


def _in_lines(values: NDArray[np.float64]) -> _Table:
    lines = np.zeros((WINDOW_PX, PITCH_PX), dtype=np.float32)
    lines[:, :WINDOW_PX] = values
    return lines.ravel()


NOISE_SHARE = float((924 / 64**2) ** 2)
"""What the blur leaves of the variance of white noise: the sum of its squared weights, each way C(12, 6) / 64²."""
SINC = _sinc()
"""(FRACTIONS + 1, 6) at fractions 0 … 1: they move blurred texture to 0.002 px."""
INSIDE = _in_lines(np.ones((WINDOW_PX, WINDOW_PX)))
"""(768,) 1 within the patch and 0 in what fills its lines up."""
ACROSS, DOWN = map(_in_lines, np.meshgrid(np.linspace(-1, 1, WINDOW_PX), np.linspace(-1, 1, WINDOW_PX)))
"""(768,) x and y within the patch, −1 … 1."""

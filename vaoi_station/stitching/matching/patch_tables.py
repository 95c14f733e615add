"""Sizes of a patch and the weights of its blur and of the interpolation: constants of `refinement`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW_PX = 24
"""Side of a patch: three vector registers of eight pixels."""
PITCH_PX = 32
"""Distance of two lines of a patch or tile in memory; loops run over all lines at once, and the padding is 0."""
BINOMIAL = (20, 15, 6, 1)
"""Weights of the blur in 64ths, from the centre outwards: close to a Gaussian of 1.22 px, in whole numbers, and zero at
the Nyquist frequency."""
BLUR_REACH = 3
"""Pixels on either side that the blur reads."""
TAPS = 6
"""Points of the interpolation."""
FRACTIONS = 512
"""Entries per pixel in the table of the interpolation; weights between them are linear."""
_KAISER = 6.0
"""Shape of the Kaiser window."""

_Table = NDArray[np.float32]


def _sinc() -> _Table:
    """Return the weights (FRACTIONS + 1, TAPS) of a windowed sinc; each row sums to 1, so that grey levels stay."""
    f = np.linspace(0, 1, FRACTIONS + 1)
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1) - f[:, None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(1, keepdims=True), dtype=np.float32)


def _in_lines(values: NDArray[np.float64]) -> _Table:
    """Return a patch (WINDOW_PX, WINDOW_PX) line after line, padded with 0."""
    lines = np.zeros((WINDOW_PX, PITCH_PX), dtype=np.float32)
    lines[:, :WINDOW_PX] = values
    return lines.ravel()


NOISE_SHARE = float((924 / 64**2) ** 2)
"""Share of the variance of white noise that the blur keeps: its squared weights sum to C(12, 6) / 64² in x and in y."""
SINC = _sinc()
"""(FRACTIONS + 1, 6) at fractions 0 … 1; they shift blurred texture with an error of 0.002 px."""
INSIDE = _in_lines(np.ones((WINDOW_PX, WINDOW_PX)))
"""(768,) 1 within the patch and 0 in the padding of its lines."""
ACROSS, DOWN = map(_in_lines, np.meshgrid(np.linspace(-1, 1, WINDOW_PX), np.linspace(-1, 1, WINDOW_PX)))
"""(768,) x and y within the patch, −1 … 1; 0 in the padding."""

"""Constants of `refinement`: the sizes of a patch, the weights of the blur, and the weights of the interpolation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW_PX = 24
"""Side of a patch: three vector registers of eight pixels."""
PITCH_PX = 32
"""Distance between the starts of two lines of a patch or tile in memory, in pixels.

The rest of each line is filled with 0, so that one loop can run over all lines at once."""
BINOMIAL = (20, 15, 6, 1)
"""Weights of the blur, in 64ths, from the centre outwards.

They are whole numbers, they are close to a Gaussian with σ = 1.22 px, and they remove the Nyquist frequency
completely."""
BLUR_REACH = 3
"""Number of pixels on each side of a pixel that the blur reads."""
TAPS = 6
"""Number of neighbouring pixels from which the sinc interpolates a value in one direction."""
FRACTIONS = 512
"""Number of fractions of a pixel for which `SINC` contains weights; weights in between are interpolated linearly."""
KERNEL_REACH, KERNEL_STEPS = 3, 512
"""Reach in pixels of the sinc with which frames are resampled, and number of distances per pixel in `KERNEL`."""
_KAISER = 6.0
"""Shape parameter of the Kaiser window, which limits the sinc to `TAPS` pixels."""

_Table = NDArray[np.float32]


def _sinc() -> _Table:
    """Return the weights (FRACTIONS + 1, TAPS) of a windowed sinc.

    The weights of each fraction sum to 1, so that interpolation does not change the mean grey level.
    """
    f = np.linspace(0, 1, FRACTIONS + 1)
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1) - f[:, None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(1, keepdims=True), dtype=np.float32)


def _kernel() -> _Table:
    """Return the weights of a windowed sinc at the distances 0 … KERNEL_REACH, `KERNEL_STEPS` per pixel."""
    at = np.arange(KERNEL_REACH * KERNEL_STEPS + 2) / KERNEL_STEPS
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / KERNEL_REACH) ** 2, 0))) / np.i0(_KAISER)
    return np.asarray(np.sinc(at) * window, dtype=np.float32)


def _in_lines(values: NDArray[np.float64]) -> _Table:
    """Return the values of a patch (WINDOW_PX, WINDOW_PX) as a flat array, each line padded with 0 to PITCH_PX."""
    lines = np.zeros((WINDOW_PX, PITCH_PX), dtype=np.float32)
    lines[:, :WINDOW_PX] = values
    return lines.ravel()


NOISE_SHARE = float((924 / 64**2) ** 2)
"""Share of the variance of white noise that remains after the blur. The squared weights of the blur sum to
C(12, 6) / 64² = 924 / 64² in x, and the same in y."""
SINC = _sinc()
"""(FRACTIONS + 1, TAPS) weights of the sinc interpolation at the fractions 0 … 1 of a pixel. The error of the
interpolation displaces blurred texture by 0.002 px."""
KERNEL = _kernel()
"""(1538,) weights of the sinc, by distance from a pixel."""
INSIDE = _in_lines(np.ones((WINDOW_PX, WINDOW_PX)))
"""(768,) 1 at the pixels of a patch and 0 in the padding of its lines."""
ACROSS, DOWN = map(_in_lines, np.meshgrid(np.linspace(-1, 1, WINDOW_PX), np.linspace(-1, 1, WINDOW_PX)))
"""(768,) the coordinates x and y of each pixel of a patch, from −1 to 1; 0 in the padding of its lines."""

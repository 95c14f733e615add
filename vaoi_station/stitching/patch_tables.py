"""Sizes of a patch, and the weights of its blur and of the interpolation: constants of `refine`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW_PX = 24
"""Side of the patch that is compared: three vector registers of eight."""
BLUR_PX = 1.2
BLUR_REACH = 4
TAPS = 6
FRACTIONS = 512
"""Steps of a pixel in the table of the interpolation; between them its weights are linear."""
_KAISER = 6.0

_Table = NDArray[np.float32]


def _gauss() -> _Table:
    weights = np.exp(-0.5 * (np.arange(BLUR_REACH + 1) / BLUR_PX) ** 2)
    return np.asarray(weights / (2 * weights.sum() - weights[0]), dtype=np.float32)


def _twice() -> _Table:
    one = np.concatenate([_gauss()[:0:-1], _gauss()])
    both = np.convolve(one, one)[2 * BLUR_REACH :][: BLUR_REACH + 1]
    return np.asarray(both / (2 * both.sum() - both[0]), dtype=np.float32)


def _sinc() -> _Table:
    f = np.linspace(0, 1, FRACTIONS + 1)
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1) - f[:, None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(1, keepdims=True), dtype=np.float32)


GAUSS = _gauss()
"""(5,) weights of the blur, from the middle outwards."""
TWICE = _twice()
"""(5,) of the blur done twice, cut off where it is next to nothing."""
SINC = _sinc()
"""(FRACTIONS + 1, 6) at fractions 0 … 1: they move blurred texture to 0.002 px."""
ACROSS, DOWN = (
    v.astype(np.float32).ravel() for v in np.meshgrid(np.linspace(-1, 1, WINDOW_PX), np.linspace(-1, 1, WINDOW_PX))
)
"""(576,) x and y within the patch, −1 … 1."""

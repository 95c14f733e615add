"""Marks painted exactly, filmed as recorded cases are: what a measurement of marks is held against."""

from __future__ import annotations

import math
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.mark_shape import Shape

Condition = Literal["clean", "noise", "slope", "copper"]
CONDITIONS: dict[Condition, str] = {
    "clean": "blur of 0.6 px, rounded to grey levels",
    "noise": "with shot noise (0.03 per level), read noise of 1.5 levels, and vignetting of 25 % to the frame's corner",
    "slope": "clean, brighter by 0.3 % per px",
    "copper": "clean, with a track as bright as the mark 0.3 sizes from its edge, on one side",
}
_FINE = 5
"""Points per axis within a pixel."""
_LIGHT, _DARK = 200.0, 50.0
_SHOT, _READ = 0.03, 1.5
_SLOPE = 0.003
_VIGNETTE, _FRAME_PX = 0.25, (1392, 1040)


def paint(shape: Shape, light: bool, size_px: float, at: Floats, side: int, copper: bool) -> Floats:
    """A mark at (2,) px on a square picture, (side, side) in grey levels, blurred by 0.6 px."""
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - 0.5
    cover = _covered(shape, fine[None] - at[0], fine[:, None] - at[1], size_px)
    if copper:
        track = fine - at[0] - 0.8 * size_px
        cover = np.maximum(cover, _within(np.abs(track - 0.25 * size_px) - 0.25 * size_px)[None])
    smooth = cv2.GaussianBlur(cover, (0, 0), 0.6 * _FINE)
    share = smooth.reshape(side, _FINE, side, _FINE).mean((1, 3))
    return np.asarray(_DARK + (_LIGHT - _DARK) * (share if light else 1 - share))


def film(picture: Floats, condition: Condition, g: np.random.Generator) -> tuple[NDArray[np.uint8], Floats]:
    """A picture under a condition, and the variance of every pixel's noise."""
    side = len(picture)
    at = np.arange(side) - (side - 1) / 2
    if condition == "slope":
        picture = picture * (1 + _SLOPE * at)[None]
    variance = np.full_like(picture, 1 / 12)
    if condition == "noise":
        place = g.uniform(-0.5, 0.5, 2) * (np.array(_FRAME_PX) - side)
        u, v = (2 * (at + p) / extent for p, extent in zip(place, _FRAME_PX, strict=True))
        picture = picture * (1 - _VIGNETTE * (u[None] ** 2 + v[:, None] ** 2) / 2)
        variance = variance + _SHOT * picture + _READ**2
        picture = picture + g.normal(size=picture.shape) * np.sqrt(variance)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), variance


def bound_px(picture: Floats, variance: Floats) -> float:
    """Cramér-Rao bound of the place, per axis, were nothing else unknown."""
    waves = 2j * np.pi * np.fft.fftfreq(len(picture))
    spectrum = np.fft.fft2(picture)  # differences of neighbours would make edges softer than they are
    gx, gy = (np.fft.ifft2(spectrum * way).real for way in (waves[None], waves[:, None]))
    information = np.array([[(a * b / variance).sum() for b in (gx, gy)] for a in (gx, gy)])
    return float(math.sqrt(np.trace(np.linalg.inv(information)) / 2))


def _covered(shape: Shape, x: Floats, y: Floats, size: float) -> Floats:
    x, y, r = np.abs(x), np.abs(y), size / 2
    if shape == "circle":
        return _within(np.hypot(x, y) - r)
    if shape == "square":
        return _within(x - r) * _within(y - r)
    if shape == "diamond":
        return _within_diagonal((x + y - r) * _FINE)
    return np.maximum(_within(x - r) * _within(y - r / 4), _within(x - r / 4) * _within(y - r))


def _within_diagonal(cells: Floats) -> Floats:
    """Share of a fine cell on the near side of an outline at 45° that meets the axes so many cells away."""
    t = np.clip(cells, -1, 1)
    return np.asarray(np.where(t < 0, 1 - (1 + t) ** 2 / 2, (1 - t) ** 2 / 2))


def _within(beyond: Floats) -> Floats:
    """Share of a fine cell that lies on the near side of an outline `beyond` px away."""
    return np.asarray(np.clip(0.5 - beyond * _FINE, 0, 1))

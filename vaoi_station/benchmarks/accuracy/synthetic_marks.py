"""Render marks with exactly known centres, under imaging conditions like those of the recorded cases."""

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
"""Number of samples per pixel along each axis, from which a pixel's grey level is averaged."""
_LIGHT, _DARK = 200.0, 50.0
"""Grey levels of a light mark and its ground; for a dark mark, they are exchanged."""
_SHOT, _READ = 0.03, 1.5
_SLOPE = 0.003
_VIGNETTE, _FRAME_PX = 0.25, (1392, 1040)


def render_mark(shape: Shape, light: bool, size_px: float, at: Floats, side: int, copper: bool) -> Floats:
    """Render a mark on a ground, blurred by 0.6 px.

    Args:
        shape: shape of the mark.
        light: whether the mark is lighter than its ground.
        size_px: size of the mark.
        at: (2,) centre of the mark, px.
        side: width and height of the image.
        copper: whether a track runs beside the mark.

    Returns:
        (side, side) grey levels, not rounded.
    """
    # Centres of the samples; pixel 0 reaches from −0.5 to 0.5 (docs/conventions.md).
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - 0.5
    cover = _covered(shape, fine[None] - at[0], fine[:, None] - at[1], size_px)
    if copper:
        track = fine - at[0] - 0.8 * size_px
        cover = np.maximum(cover, _within(np.abs(track - 0.25 * size_px) - 0.25 * size_px)[None])
    smooth = cv2.GaussianBlur(cover, (0, 0), 0.6 * _FINE)
    share = smooth.reshape(side, _FINE, side, _FINE).mean((1, 3))
    return np.asarray(_DARK + (_LIGHT - _DARK) * (share if light else 1 - share))


def apply_condition(image: Floats, condition: Condition, g: np.random.Generator) -> tuple[NDArray[np.uint8], Floats]:
    """Return the image as a camera takes it under an imaging condition, and the noise variance of each pixel."""
    side = len(image)
    at = np.arange(side) - (side - 1) / 2
    if condition == "slope":
        image = image * (1 + _SLOPE * at)[None]
    # Rounding to whole grey levels has a variance of 1/12.
    variance = np.full_like(image, 1 / 12)
    if condition == "noise":
        # The mark lies anywhere in a full frame, which decides how much vignetting it has.
        place = g.uniform(-0.5, 0.5, 2) * (np.array(_FRAME_PX) - side)
        u, v = (2 * (at + p) / extent for p, extent in zip(place, _FRAME_PX, strict=True))
        image = image * (1 - _VIGNETTE * (u[None] ** 2 + v[:, None] ** 2) / 2)
        variance = variance + _SHOT * image + _READ**2
        image = image + g.normal(size=image.shape) * np.sqrt(variance)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), variance


def cramer_rao_px(image: Floats, variance: Floats) -> float:
    """Return the Cramér-Rao bound of a mark's centre, px per axis, assuming that only the centre is unknown.

    Args:
        image: grey levels of the mark without noise.
        variance: noise variance of each pixel.
    """
    waves = 2j * np.pi * np.fft.fftfreq(len(image))
    # Derivatives come from the Fourier transform: differences of neighbouring pixels would make edges softer.
    spectrum = np.fft.fft2(image)
    gx, gy = (np.fft.ifft2(spectrum * way).real for way in (waves[None], waves[:, None]))
    information = np.array([[(a * b / variance).sum() for b in (gx, gy)] for a in (gx, gy)])
    return float(math.sqrt(np.trace(np.linalg.inv(information)) / 2))


def _covered(shape: Shape, x: Floats, y: Floats, size: float) -> Floats:
    """Return the share of each sample at (x, y), px, that a shape at the origin covers."""
    x, y, r = np.abs(x), np.abs(y), size / 2
    if shape == "circle":
        return _within(np.hypot(x, y) - r)
    if shape == "square":
        return _within(x - r) * _within(y - r)
    if shape == "diamond":
        return _within_diagonal((x + y - r) * _FINE)
    return np.maximum(_within(x - r) * _within(y - r / 4), _within(x - r / 4) * _within(y - r))


def _within_diagonal(cells: Floats) -> Floats:
    """Return the share of a sample inside an outline at 45°. `cells` is its distance along an axis, in samples."""
    # Integral of the triangular width of a unit square along its diagonal.
    t = np.clip(cells, -1, 1)
    return np.asarray(np.where(t < 0, 1 - (1 + t) ** 2 / 2, (1 - t) ** 2 / 2))


def _within(beyond: Floats) -> Floats:
    """Return the share of a sample inside an outline, if the sample's centre lies `beyond` px outside the outline."""
    return np.asarray(np.clip(0.5 - beyond * _FINE, 0, 1))

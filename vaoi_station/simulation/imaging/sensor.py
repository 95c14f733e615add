"""Simulate lens and sensor: motion blur, pixel area, lens blur, brightness, noise and clipping."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.board.canvas import Plane
from vaoi_station.simulation.imaging.lattice import OVERSAMPLING
from vaoi_station.simulation.scenario import ArraySection

_MIN_MOTION = 1e-3
_STEPS_PER_SAMPLE = 64


def expose(
    samples: Plane,
    array: ArraySection,
    *,
    motion_px: Floats,
    brightness: float,
    shade: Plane,
    noise: np.random.Generator | None,
) -> NDArray[Any]:
    """Return the frame (h, w), uint8 or uint16, that the sensor delivers for a scene of two samples per pixel and axis.

    The motion (2,) of the image during the exposure is centred on the pulse. The brightness is the product of light,
    relative exposure and gain; `shade` (h, w) is that over the frame. Without a generator there is no noise.
    """
    h, w = samples.shape[0] // OVERSAMPLING, samples.shape[1] // OVERSAMPLING
    kernel = motion_kernel(motion_px * OVERSAMPLING)
    # Motion blur comes before the reduction to pixels, because it acts on the light and not on pixel values.
    moved: Plane = cv2.filter2D(samples, -1, kernel) if kernel.size > 1 else samples
    image: Plane = cv2.resize(moved, (w, h), interpolation=cv2.INTER_AREA)
    if array.psf_px:
        image = cv2.GaussianBlur(image, (0, 0), array.psf_px)
    image = image * shade * np.float32(brightness)
    if noise is not None and (array.shot_noise or array.read_noise):
        # Shot noise grows with the square root of the light. Read noise does not depend on the light.
        sigma = np.sqrt(np.maximum(image, 0) * np.float32(array.shot_noise) + np.float32(array.read_noise**2))
        image = image + noise.standard_normal(image.shape, dtype=np.float32) * sigma
    image = image + np.float32(array.black_level)
    if array.bits == 16:
        return np.asarray(np.clip(np.rint(image * np.float32(256)), 0, 65535).astype(np.uint16))
    return np.asarray(np.clip(np.rint(image), 0, 255).astype(np.uint8))


def motion_kernel(path: Floats) -> Plane:
    """Return the kernel of motion blur along a straight path (2,), in samples, that is centred on each sample.

    It averages the bilinearly interpolated image along the path. Its entries sum to 1.
    """
    length = math.hypot(*path)
    # A motion of a thousandth of a sample is invisible, so the image is left unchanged.
    if length < _MIN_MOTION:
        return np.ones((1, 1), np.float32)
    steps = max(int(length * _STEPS_PER_SAMPLE), _STEPS_PER_SAMPLE)
    at = (np.arange(steps) + 0.5) / steps - 0.5
    hats = []
    for part in path:
        reach = math.ceil(abs(part) / 2)
        cells = np.arange(-reach, reach + 1)
        hats.append(np.clip(1 - np.abs(cells[None] - at[:, None] * part), 0, 1))
    kernel = hats[1].T @ hats[0] / steps
    return np.asarray(kernel / kernel.sum(), np.float32)


def vignette(array: ArraySection, camera: int) -> Plane:
    """Return the relative brightness (h, w) of a frame under even light: a quadratic about a point near its centre."""
    g = np.random.default_rng([array.seed, 7004, camera])
    x0, y0 = g.normal(0, 0.15, 2)
    width_px, height_px = array.frame_px(camera)
    x, y = np.linspace(-1, 1, width_px) - x0, np.linspace(-1, 1, height_px) - y0
    return np.asarray(1 - array.vignetting * (x[None] ** 2 + y[:, None] ** 2) / 2, np.float32)


def generator(*key: int) -> np.random.Generator:
    """Return a random generator for a key. Equal keys give equal numbers; other generators have no influence."""
    # SFC64 must stay: a different generator would change the noise of every simulated frame.
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(key)))

"""The twin's pixels against a slow, independent computation, written out from the conventions alone:

tester plane z = 0, mm; pixel centres at integer coordinates; D_j = E_j E_0⁻¹, M_ij = N_i D_j; a pixel is the
mean of 2 × 2 samples; textures are sampled bilinearly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.simulation import Twin
from vaoi_station.simulation.imaging.sensor import vignette

Array = NDArray[np.float64]
Make = Callable[..., Twin]


def _board_places(twin: Twin, pose: Array, pixels: Array) -> Array:
    """Board mm seen at raw pixels, on a lifted, tilted and bowed surface."""
    camera, lens = twin.pinholes[0], twin.calibration.distortion
    assert lens is not None
    q = pixels - lens[0].center
    pixels = lens[0].center + q * (1 + lens[0].radial[0] * (q**2).sum(1) / lens[0].radius ** 2)[:, None]
    board, back = twin.scenario.board, np.linalg.inv(pose)
    z, places = np.zeros(len(pixels)), pixels
    p, (u, v) = camera.projection, pixels.T[:, :, None]
    m = np.stack([p[0] - u * p[2], p[1] - v * p[2]], 1)  # m @ (x, y, z, 1) = 0, for every pixel
    for _ in range(8):
        ground = np.linalg.solve(m[:, :, :2], -(m[:, :, 2:3] * z[:, None, None] + m[:, :, 3:]))[:, :, 0]
        places = ground @ back[:2, :2].T + back[:2, 2]
        s, t = places[:, 0] / board.width_mm * 2 - 1, places[:, 1] / board.length_mm * 2 - 1
        flat = board.lift_mm + board.tilt_mm[0] * s + board.tilt_mm[1] * t
        z = flat + board.bow_mm * (1 - 0.4 * s**2 - 0.6 * t**2)
    return places


def _bilinear(texture: NDArray[Any], x: Array, y: Array, outside: float) -> Array:
    padded = np.pad(texture.astype(float), 2, constant_values=outside)
    x, y = np.clip(x + 2, 0, padded.shape[1] - 2), np.clip(y + 2, 0, padded.shape[0] - 2)
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = x - i, y - j
    upper = padded[j, i] * (1 - a) + padded[j, i + 1] * a
    return np.asarray(upper * (1 - b) + (padded[j + 1, i] * (1 - a) + padded[j + 1, i + 1] * a) * b)


def _blurred(image: Array, sigma: float) -> Array:
    weights = np.exp(-0.5 * (np.arange(-3, 4) / sigma) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        image = np.sum([w * np.roll(image, k - 3, axis) for k, w in enumerate(weights)], axis=0)
    return image


def _picture(twin: Twin, pose: Array) -> Array:
    array, art = twin.scenario.array, twin.artwork
    at = (np.arange(2 * array.width_px) + 0.5) / 2 - 0.5, (np.arange(2 * array.height_px) + 0.5) / 2 - 0.5
    pixels = np.stack(np.meshgrid(*at), -1).reshape(-1, 2)
    t = (_board_places(twin, pose, pixels) - art.origin_mm) * art.px_per_mm - 0.5
    samples = _bilinear(art.surface, t[:, 0], t[:, 1], twin.scenario.belt.grey)
    return np.asarray(samples.reshape(array.height_px, 2, array.width_px, 2).mean((1, 3)))


def test_pixels_equal_an_independent_computation(make: Make) -> None:
    twin = make(
        array={
            "width_px": 72,
            "height_px": 56,
            "distortion_px": 0.3,
            "psf_px": 0.6,
            "vignetting": 0.2,
            "black_level": 3.0,
            "gain": 0.9,
        },
        belt={"yaw_deg": 3.0, "direction": -1},
        board={
            "bow_mm": 1.0,
            "lift_mm": 0.4,
            "tilt_mm": [0.3, -0.2],
            "fiducials": [{"x_mm": 15.0, "y_mm": 10.0, "diameter_mm": 1.5, "shape": "diamond"}],
        },
        line={"barrier_mm": 10.0},
        lights={"ring": {"gain": [1.1]}},
    )
    passage = twin.passage(2)
    row = min(range(passage.rows), key=lambda r: abs(float((passage.pose(passage.pulse_times_s[r]) @ [15, 10, 1])[1])))
    expected = _blurred(_picture(twin, passage.pose(passage.pulse_times_s[row])), 0.6)
    expected = expected * vignette(twin.scenario.array, 0) * 0.9 * 1.1 + 3.0
    difference = (passage.frame(0, row) - expected)[5:-5, 5:-5]
    assert expected.max() > 150  # the fiducial is in view
    assert np.abs(difference).max() <= 1.0
    assert abs(difference.mean()) < 0.05


@pytest.mark.parametrize("length_px", [1.0, 3.6])
def test_motion_blur_is_the_mean_of_the_poses_during_the_exposure(make: Make, length_px: float) -> None:
    exposure_us = length_px / 10.0 / 100.0 * 1e6
    twin = make(
        array={
            "width_px": 72, "height_px": 56, "distortion_px": 0.01,
            "exposures_us": [exposure_us], "reference_exposure_us": exposure_us,
        },
        belt={"skew_deg": 10.0},
        board={"fiducials": [{"x_mm": 15.0, "y_mm": 10.0, "diameter_mm": 2.0}]},
    )  # fmt: skip
    passage = twin.passage(0)
    row = min(range(passage.rows), key=lambda r: abs(float((passage.pose(passage.pulse_times_s[r]) @ [15, 10, 1])[1])))
    t = passage.pulse_times_s[row]
    steps = ((np.arange(16) + 0.5) / 16 - 0.5) * exposure_us * 1e-6
    expected = np.mean([_picture(twin, passage.pose(t + dt)) for dt in steps], axis=0)
    difference = (passage.frame(0, row) - expected)[5:-5, 5:-5]
    assert np.abs(difference).max() < 9  # the kernel works on the samples: edges are a little softer
    assert abs(difference.mean()) < 0.05
    y, x = np.mgrid[5:51, 5:67]
    light = np.where((expected > 60)[5:-5, 5:-5], 1.0, 0.0)
    for axis in (x, y):
        seen = (passage.frame(0, row)[5:-5, 5:-5] * light * axis).sum() / (
            passage.frame(0, row)[5:-5, 5:-5] * light
        ).sum()
        true = (expected[5:-5, 5:-5] * light * axis).sum() / (expected[5:-5, 5:-5] * light).sum()
        assert math.isclose(seen, true, abs_tol=0.01)

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.imaging.sensor import expose, generator, motion_kernel, vignette
from vaoi_station.simulation.scenario import ArraySection

WAY = st.floats(-8, 8)


@given(WAY, WAY)
def test_motion_kernels_are_symmetric_and_of_sum_one(x: float, y: float) -> None:
    kernel = motion_kernel(np.array([x, y]))
    assert abs(float(kernel.sum()) - 1) < 1e-5
    assert np.allclose(kernel, kernel[::-1, ::-1], atol=1e-6)
    assert kernel.shape[0] % 2 == 1
    assert kernel.shape[1] % 2 == 1


def test_noise_has_the_stated_variance_and_clips() -> None:
    array = ArraySection(psf_px=0.0, shot_noise=0.05, read_noise=2.0, black_level=10.0, bits=16)
    samples, shade = np.full((400, 400), 80.0, np.float32), np.ones((200, 200), np.float32)
    image = expose(samples, array, motion_px=np.zeros(2), brightness=1.0, shade=shade, noise=generator(1, 2)) / 256
    assert abs(float(image.mean()) - 90) < 0.1
    assert abs(float(image.var()) - (80 * 0.05 + 4)) < 0.2
    bright = expose(samples, array, motion_px=np.zeros(2), brightness=4.0, shade=shade, noise=None)
    assert bright.dtype == np.uint16
    assert (bright == 65535).all()


def test_vignetting_darkens_the_corners() -> None:
    shade = vignette(ArraySection(width_px=64, height_px=48, vignetting=0.4), 1)
    assert shade.shape == (48, 64)
    assert shade.max() <= 1
    assert shade[24, 32] > shade[0, 0]

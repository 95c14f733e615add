from __future__ import annotations

import numpy as np

from vaoi_station.simulation.imaging.sensor import expose, generator
from vaoi_station.simulation.scenario import ArraySection


def test_noise_has_the_stated_variance_and_clips() -> None:
    array = ArraySection(psf_px=0.0, shot_noise=0.05, read_noise=2.0, black_level=10.0, bits=16)
    samples, shade = np.full((400, 400), 80.0, np.float32), np.ones((200, 200), np.float32)
    image = expose(samples, array, motion_px=np.zeros(2), brightness=1.0, shade=shade, noise=generator(1, 2)) / 256
    assert abs(float(image.mean()) - 90) < 0.1
    assert abs(float(image.var()) - (80 * 0.05 + 4)) < 0.2
    bright = expose(samples, array, motion_px=np.zeros(2), brightness=4.0, shade=shade, noise=None)
    assert bright.dtype == np.uint16
    assert (bright == 65535).all()

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.imaging.sensor import expose, generator, motion_kernel
from vaoi_station.simulation.scenario import ArraySection

WAY = st.floats(-8, 8)


def test_noise_has_the_stated_variance_and_clips() -> None:
    array = ArraySection(psf_px=0.0, shot_noise=0.05, read_noise=2.0, black_level=10.0, bits=16)
    samples, shade = np.full((400, 400), 80.0, np.float32), np.ones((200, 200), np.float32)
    image = expose(samples, array, motion_px=np.zeros(2), brightness=1.0, shade=shade, noise=generator(1, 2)) / 256
    assert abs(float(image.mean()) - 90) < 0.1
    assert abs(float(image.var()) - (80 * 0.05 + 4)) < 0.2
    bright = expose(samples, array, motion_px=np.zeros(2), brightness=4.0, shade=shade, noise=None)
    assert bright.dtype == np.uint16
    assert (bright == 65535).all()


@given(WAY, WAY)
def test_a_motion_kernel_has_the_second_moment_of_the_motion(x: float, y: float) -> None:
    """A straight path of length L adds L²/12 along it, and bilinear interpolation adds at most 1/4 per axis."""
    kernel = motion_kernel(np.array([x, y])).astype(float)
    h, w = kernel.shape
    rows, columns = np.mgrid[:h, :w] - np.array([(h - 1) / 2, (w - 1) / 2])[:, None, None]
    for offsets, length in ((columns, x), (rows, y)):
        assert 0 <= (kernel * offsets**2).sum() - length**2 / 12 + 1e-3 <= 0.26


@pytest.mark.parametrize(("bits", "kind", "scale"), [(8, np.uint8, 1), (16, np.uint16, 256)])
def test_an_even_scene_gives_an_even_frame(bits: int, kind: type, scale: int) -> None:
    array = ArraySection.model_validate({"psf_px": 0.0, "black_level": 3.0, "bits": bits})
    samples, shade = np.full((40, 60), 50.0, np.float32), np.full((20, 30), 0.5, np.float32)
    image = expose(samples, array, motion_px=np.zeros(2), brightness=2.0, shade=shade, noise=None)
    assert image.dtype == kind
    assert image.shape == (20, 30)
    assert set(np.unique(image)) == {53 * scale}


@given(st.lists(st.integers(0, 2**31), min_size=1, max_size=4))
def test_random_numbers_belong_to_their_key(key: list[int]) -> None:
    first, again, other = (generator(*k).standard_normal(4) for k in (key, key, [*key, 1]))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)

"""A plane is decoded from its own content only."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.plant.archive.frames.plane_codec import decode_plane, encode_plane

PLANE = np.random.default_rng(3).integers(0, 900, (21, 34)).astype(np.uint16)


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("shape", [(21, 34), (20, 33), (3, 1), (1, 3), (5, 2)])
def test_a_plane_comes_back(step: int, shape: tuple[int, int]) -> None:
    plane = PLANE[: shape[0], : shape[1]]
    assert np.array_equal(decode_plane(encode_plane(plane, step), shape), plane)


@pytest.mark.parametrize("step", [1, 2])
def test_what_is_predicted_beyond_the_range_of_a_pixel_comes_back(step: int) -> None:
    """Sums are taken modulo 2^32, and residuals modulo 2^16."""
    steep = ((np.arange(40)[:, None] * 13_000 + np.arange(50) * 9_000) % 65536).astype(np.uint16)
    edges = np.where((np.indices((40, 50)).sum(0) // 7) % 2, 65535, 0).astype(np.uint16)
    for plane in (steep, edges):
        assert np.array_equal(decode_plane(encode_plane(plane, step), plane.shape), plane)


def test_a_plane_of_another_shape_is_refused_or_differs() -> None:
    with pytest.raises(ValueError, match="end too early"):
        decode_plane(encode_plane(PLANE, 1), (210, 34))


def test_an_invalid_head_is_refused() -> None:
    with pytest.raises(ValueError, match="head of a plane is invalid"):
        decode_plane(b"\3" + encode_plane(PLANE, 1)[1:], PLANE.shape)


def test_large_residuals_follow_each_other_in_every_stream() -> None:
    """Two of them, of up to 25 bits each, are read from one window."""
    plane = np.random.default_rng(4).integers(0, 65536, (64, 96)).astype(np.uint16)
    assert np.array_equal(decode_plane(encode_plane(plane, 1), plane.shape), plane)


def test_a_plane_that_is_cut_is_refused() -> None:
    with pytest.raises(ValueError, match="shorter than its head says"):
        decode_plane(encode_plane(PLANE, 1)[:-1], PLANE.shape)

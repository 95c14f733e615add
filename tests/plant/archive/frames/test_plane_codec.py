"""A plane is decoded from its own content only."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.plant.archive.frames.plane_codec import decode_plane, encode_plane

PLANE = np.random.default_rng(3).integers(0, 900, (21, 34)).astype(np.uint16)


@pytest.mark.parametrize("step", [1, 2])
def test_a_plane_comes_back(step: int) -> None:
    assert np.array_equal(decode_plane(encode_plane(PLANE, step), PLANE.shape), PLANE)


def test_a_plane_of_another_shape_is_refused_or_differs() -> None:
    with pytest.raises(ValueError, match="end too early"):
        decode_plane(encode_plane(PLANE, 1), (210, 34))


def test_an_invalid_head_is_refused() -> None:
    with pytest.raises(ValueError, match="head of a plane is invalid"):
        decode_plane(b"\x03" + encode_plane(PLANE, 1)[1:], PLANE.shape)

"""Frames that are divided by flat fields."""

from __future__ import annotations

import numpy as np

from vaoi_station.heights.equalised_frames import equalised_frames
from vaoi_station.photometry import FieldMaps, FlatFields, NoiseModel


class OneField(FlatFields):
    """The same maps for every camera; darker where the flat field is 0.5."""

    def maps(self, camera: int, light: str | None) -> FieldMaps:
        flat = np.array([[1.0, 0.5, 1.0], [0.5, 0.5, 2.0]], np.float32)
        return FieldMaps(flat if light == "left" else None, 2.0, NoiseModel())


FRAME = np.array([[102, 52, 255], [12, 2, 22]], np.uint8)


def test_a_frame_is_divided_by_the_flat_field_of_its_light() -> None:
    frames = equalised_frames(lambda i, j: FRAME if j < 2 else None, OneField(), ("left", "right", "left"))
    left, right = frames(0, 0), frames(0, 1)
    assert left is not None
    assert right is not None
    assert left.dtype == np.float32
    np.testing.assert_allclose(left[:, :2], [[100, 100], [20, 0]])
    np.testing.assert_allclose(right[:, :2], [[100, 50], [10, 0]])
    assert frames(0, 2) is None


def test_saturated_pixels_stay_saturated() -> None:
    frames = equalised_frames(lambda i, j: FRAME, OneField(), ("left",))
    value = frames(0, 0)
    assert value is not None
    assert value[0, 2] >= 252
    assert value[1, 2] == 10

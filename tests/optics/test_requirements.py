from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.optics.paper_example import PAPER


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"width_mm": 0}, "width_mm is 0, but must be a finite number above 0"),
        ({"width_mm": None}, "width_mm is None, but must be a finite number above 0"),
        ({"resolution_px_per_mm": float("nan")}, "resolution_px_per_mm is nan"),
        ({"speed_mm_s": float("inf")}, "speed_mm_s is inf"),
        ({"speed_mm_s": "100"}, "speed_mm_s is '100'"),
        ({"sensor_px_h": 1392.5}, "sensor_px_h is 1392.5, but must be a whole number, 1 or above"),
        ({"sensor_px_v": None}, "sensor_px_v is None, but must be a whole number"),
        ({"cameras": 0}, "cameras is 0, but must be a whole number, 1 or above"),
        ({"multiplicity_h": 0.99}, "multiplicity_h is 0.99, but must be 1 or above"),
        ({"multiplicity_v": 0.5}, "multiplicity_v is 0.5, but must be 1 or above"),
        ({"blur_px": -1}, "blur_px is -1"),
        ({"exposure_us": 0}, "exposure_us is 0"),
        ({"readout_us": -1}, "readout_us is -1, but must be a finite number, 0 or above"),
        ({"bits_per_pixel": 65}, "bits_per_pixel is 65, but must be at most 64"),
        ({"distance_min_mm": 501}, "distance_min_mm is 501, but must be at most distance_max_mm, 500.0 mm"),
        ({"depth_of_field_mm": 500}, "depth_of_field_mm is 500, but must be below distance_max_mm"),
        ({"circle_of_confusion_mm": 6.4}, "circle_of_confusion_mm is 6.4, but must be below sensor_width_mm, 6.4 mm"),
    ],
)
def test_invalid_quantities_are_refused_with_field_value_and_limit(change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        replace(PAPER, **change)
    assert str(refused.value).startswith(f"requirements: {complaint}")


def test_requirements_are_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        PAPER.width_mm = 1.0  # type: ignore[misc]

"""Requests for images: what is outside its limits is refused with value and limit, and options come back by name."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.rendering.request import Framing, ImageOptions, ImageRequest


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"seen_from": "up"}, "seen_from is 'up', but must be 'left' or 'right' or 'front' or 'back'"),
        ({"seen_from": 400.0}, "seen_from is 400.0, but must be 'left', 'right', 'front', 'back' or an azimuth in CAD"),
        ({"seen_from": float("nan")}, "seen_from is nan"),
        ({"within_deg": 200}, "within_deg is 200, but must be None or a number from 0 to 180"),
        ({"within_deg": 30}, "within_deg is 30, but no seen_from is given"),
        ({"min_angle_deg": 30, "max_angle_deg": 10}, "min_angle_deg is 30, but must be at most max_angle_deg, 10"),
        ({"max_angle_deg": 91}, "max_angle_deg is 91, but must be a number from 0 to 90"),
        ({"min_exposure_us": 9, "max_exposure_us": 5}, "min_exposure_us is 9, but must be at most max_exposure_us, 5"),
        ({"min_exposure_us": -1}, "min_exposure_us is -1"),
        ({"min_coverage": 1.5}, "min_coverage is 1.5, but must be a number from 0 to 1"),
        ({"min_sharpness_per_mm": -2}, "min_sharpness_per_mm is -2"),
        ({"max_saturated": 2}, "max_saturated is 2, but must be None or a number from 0 to 1"),
        ({"order": "worst"}, "order is 'worst', but must be 'best' or 'sharpest'"),
        ({"limit": 0}, "limit is 0, but must be a whole number from 1 to 100000"),
        ({"limit": True}, "limit is True"),
        ({"minus": "left"}, "minus is 'left', but no light is given"),
        ({"light": "left", "minus": "left"}, "minus is 'left', but must be another light than light"),
        ({"margin_mm": 101}, "margin_mm is 101, but must be a number from 0 to 100"),
    ],
)
def test_an_option_outside_its_limits_is_refused(options: Any, words: str) -> None:
    with pytest.raises(InputError) as refused:
        ImageRequest.of(options)
    assert words in str(refused.value)


def test_options_come_back_by_name() -> None:
    options: ImageOptions = {"light": "left", "px_per_mm": 20.0, "limit": 3, "order": "sharpest", "min_coverage": 0.9}
    wanted = ImageRequest.of(options)
    assert wanted.options() == options
    assert wanted.needs_pixels
    assert ImageRequest().options() == {}
    assert not ImageRequest.of({"measure": True}).needs_pixels
    assert ImageRequest.of({"measure": True}).unmeasured().options() == {}
    assert ImageRequest.of({"max_saturated": 0.1}).needs_pixels


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"px_per_mm": 0.05}, "px_per_mm is 0.05, but must be None or a number from 0.1 to 1000"),
        ({"px_per_mm": float("nan")}, "px_per_mm is nan"),
        ({"margin_mm": -1}, "margin_mm is -1, but must be a number from 0 to 100"),
        ({"margin_mm": 250.0}, "margin_mm is 250.0, but must be a number from 0 to 100"),
        ({"margin_mm": True}, "margin_mm is True"),
        ({"align": "north"}, "align is 'north', but must be 'cad' or 'part'"),
        ({"plane": "roof"}, "plane is 'roof', but must be 'board' or 'top'"),
    ],
)
def test_a_value_outside_its_limits_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refused:
        Framing(**values).check()
    assert words in str(refused.value)

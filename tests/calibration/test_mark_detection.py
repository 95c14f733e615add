from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.calibration.mark_detection import MarkAppearance, detect_marks, measure_blur_px, to_grey
from vaoi_station.files.layouts import Layout

KIND = MarkAppearance(24.0, 0.25, light=False)


def _of(rig: Any) -> tuple[Any, Any]:
    frame = rig.frames[0]
    at = np.array([rig.seen_at(0, k) for k in rig.in_view(0)])
    return frame, at


def test_every_mark_is_detected_to_a_few_hundredths_of_a_pixel(rig: Any) -> None:
    frame, at = _of(rig)
    seen = detect_marks(frame, KIND)
    assert len(seen.px) == len(at)
    nearest = [np.hypot(*(seen.px - p).T).min() for p in at]
    assert max(nearest) < 0.03
    assert not seen.doubtful
    assert seen.opposite == 0


def test_colour_and_sixteen_bits_are_the_same_marks(rig: Any) -> None:
    frame, _ = _of(rig)
    plain = detect_marks(frame, KIND)
    assert np.array_equal(to_grey(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)), frame)
    twelve_bits = to_grey(frame.astype(np.uint16) * 16)
    assert twelve_bits.dtype == np.uint8
    deep = detect_marks(twelve_bits, KIND)
    assert len(deep.px) == len(plain.px)
    assert max(np.hypot(*(deep.px - p).T).min() for p in plain.px) < 0.01


def test_light_marks_are_opposite(rig: Any) -> None:
    frame, at = _of(rig)
    seen = detect_marks(255 - frame, KIND)
    assert len(seen.px) == 0
    assert seen.opposite == len(at)


def test_a_half_covered_mark_is_doubtful(rig: Any) -> None:
    frame, at = _of(rig)
    x, y = np.round(at[0]).astype(int)
    frame = frame.copy()
    frame[y - 13 : y + 13, x + 5 : x + 14] = 190
    seen = detect_marks(frame, KIND)
    assert len(seen.px) == len(at) - 1
    assert all("covered or damaged" in why for _, why in seen.doubtful)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0])
def test_blur_is_measured_at_the_edges(rig: Any, sigma: float) -> None:
    frame, at = _of(rig)
    soft = cv2.GaussianBlur(frame, (0, 0), sigma)
    expected = np.sqrt(sigma**2 + 0.6**2 + 1 / 12)
    assert measure_blur_px(soft, at, KIND.size_px) == pytest.approx(expected, rel=0.2)


def test_kinds_follow_the_layout() -> None:
    layout = Layout.model_validate(
        {
            "unit": "inch",
            "mark": {"size": 0.1, "width": 0.02, "polarity": "light"},
            "marks": [{"x": 0, "y": 0}] * 4,
        }
    )
    kind = MarkAppearance.of(layout, 10.0)
    assert kind.size_px == pytest.approx(25.4)
    assert kind.arm == pytest.approx(0.2)
    assert kind.light

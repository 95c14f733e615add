from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from vaoi_station.calibration.mark_detection import MarkAppearance, detect_marks
from vaoi_station.pixel_formats import eight_bit_grey

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
    for other in (cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), frame.astype(np.uint16) << 8):
        found = detect_marks(eight_bit_grey(other), KIND)
        assert np.array_equal(found.px, plain.px)
        assert found.contrast == plain.contrast


def test_light_marks_are_opposite(rig: Any) -> None:
    frame, at = _of(rig)
    seen = detect_marks(255 - frame, KIND)
    assert len(seen.px) == 0
    assert seen.opposite == len(at)

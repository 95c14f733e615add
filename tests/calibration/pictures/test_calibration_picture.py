from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.calibration.pictures.calibration_picture import draw_calibration


def _has(picture: np.ndarray, bgr: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture.astype(int) - bgr).max(-1) < 12).any())


def test_the_picture_shows_marks_places_and_residuals(rig: Any) -> None:
    picture = draw_calibration(rig.calibrate())
    assert picture.shape == (74 + 540, 3 * 720 + 16, 3) or picture.shape[1] == 2 * 720 + 8
    assert _has(picture, (230, 150, 40))  # expected
    assert _has(picture, (220, 0, 220))  # residual vectors
    assert not _has(picture, (30, 30, 200))


def test_the_picture_of_a_refusal_has_a_red_text(rig: Any) -> None:
    outcome = rig.calibrate(change=lambda i, f: f if i else np.full_like(f, 150))
    assert outcome.refused
    assert _has(draw_calibration(outcome), (30, 30, 200))

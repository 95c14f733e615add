from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from vaoi_station.model import Calibration, CameraHead

HEADS = tuple(CameraHead(width=w, height=64, exposure_us=100.0) for w in (80, 96))
MATRICES = (np.diag([40.0, 40.0, 1.0]), np.array([[40.0, 0, -900], [0, 40.0, 3], [0, 0, 1]]))


def calibration(**change: Any) -> Calibration:
    base = {"format": "vaoi-calibration", "version": 1, "unit": "mm", "camera_matrices": MATRICES}
    return Calibration.model_validate(base | change)


def test_cameras_have_their_lenses_and_principal_points() -> None:
    lenses = [{"center": (40, 32), "radius": 50, "radial": [a]} for a in (0.0, -0.01)]
    first, second = calibration(distortion=lenses, principal_point=[(40, 32), (47, 31)]).cameras(HEADS)
    assert first.lens.ideal
    assert second.lens.radial == (-0.01,)
    assert second.principal_point_px == (47.0, 31.0)
    raw = (80.0, 32.0)
    expected = 40 + 40 * (1 - 0.01 * (40 / 50) ** 2)
    assert second.lens.undistort(raw)[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_matrices": []}, "camera_matrices"),
        ({"residual_px": [0.1]}, "residual_px has 1 entries, must have one per camera: 2"),
        ({"principal_point": [(1, 2)] * 3}, "principal_point has 3 entries"),
        ({"distortion": []}, "distortion has 0 entries"),
        ({"covariance": [np.eye(9).tolist()]}, "covariance has 1 entries, must have one per camera: 2"),
        ({"covariance": [np.eye(8).tolist()] * 2}, r"covariance\.0\s.*has shape \(8, 8\), must be 9×9"),
        ({"covariance": [[[0.0] * 9] * 8 + [[0.0]]] * 2}, "has rows of different lengths, must be 9×9"),
        ({"covariance": [[[True] + [0.0] * 8] * 9] * 2}, "is not a matrix of numbers"),
        ({"covariance": [np.full((9, 9), np.inf).tolist()] * 2}, "has NaN or infinite entries"),
        ({"covariance": [np.triu(np.ones((9, 9))).tolist()] * 2}, "is not symmetric"),
        ({"covariance": [(-np.eye(9)).tolist()] * 2}, "has a negative eigenvalue"),
        ({"unit": "inch"}, "unit"),
        ({"working_distance_mm": 0}, "working_distance_mm"),
    ],
)
def test_inconsistent_calibrations_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        calibration(**change)

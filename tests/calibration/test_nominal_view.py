from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.nominal_view import marks_in_view, nominal_matrix
from vaoi_station.geometry.transforms import apply
from vaoi_station.model import CameraHead


def head(**change: object) -> CameraHead:
    base = {"width": 480, "height": 360, "exposure_us": 1.0, "nominal_center_mm": (30.0, -2.0)}
    return CameraHead.model_validate(base | {"nominal_px_per_mm": 20.0} | change)


@pytest.mark.parametrize("roll", [-30.0, 90.0, 180.0])
def test_a_camera_mounted_with_a_roll_sees_the_plane_turned(roll: float) -> None:
    n = nominal_matrix(head(nominal_center_mm=(3, 4), nominal_px_per_mm=5.0, nominal_roll_deg=roll), 0)
    turn = np.radians(roll)
    assert apply(n, (3, 4)) == pytest.approx((239.5, 179.5))
    assert apply(n, (4, 4)) - apply(n, (3, 4)) == pytest.approx((5 * np.cos(turn), 5 * np.sin(turn)))
    assert np.linalg.det(n) == pytest.approx(25.0)


def test_marks_in_view_are_those_of_the_nominal_field_and_its_slack() -> None:
    marks = np.array([[30.0, -2.0], [41.9, -2.0], [42.5, -2.0], [30.0, 8.0], [60.0, 0.0]])
    assert marks_in_view(head(), 0, marks).tolist() == [0, 1]
    assert marks_in_view(head(), 0, marks, slack_mm=2.0).tolist() == [0, 1, 2, 3]

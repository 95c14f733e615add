from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.calibration.nominal_view import REACH_MM, is_in_frame, marks_in_view, nominal_matrix, reach_mm
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import apply
from vaoi_station.model import CameraHead


def head(**change: object) -> CameraHead:
    base = {"width": 480, "height": 360, "exposure_us": 1.0, "nominal_center_mm": (30.0, -2.0)}
    return CameraHead.model_validate(base | {"nominal_px_per_mm": 20.0} | change)


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(1, 100))
def test_the_nominal_centre_is_imaged_at_the_centre_of_the_frame(x: float, y: float, r: float) -> None:
    n = nominal_matrix(head(nominal_center_mm=(x, y), nominal_px_per_mm=r), 0)
    assert apply(n, (x, y)) == pytest.approx((239.5, 179.5))
    assert apply(n, (x + 1, y + 2)) - apply(n, (x, y)) == pytest.approx((r, 2 * r))


@pytest.mark.parametrize("roll", [-30.0, 90.0, 180.0])
def test_a_camera_mounted_with_a_roll_sees_the_plane_turned(roll: float) -> None:
    n = nominal_matrix(head(nominal_center_mm=(3, 4), nominal_px_per_mm=5.0, nominal_roll_deg=roll), 0)
    turn = np.radians(roll)
    assert apply(n, (3, 4)) == pytest.approx((239.5, 179.5))
    assert apply(n, (4, 4)) - apply(n, (3, 4)) == pytest.approx((5 * np.cos(turn), 5 * np.sin(turn)))
    assert np.linalg.det(n) == pytest.approx(25.0)


@pytest.mark.parametrize("key", ["nominal_center_mm", "nominal_px_per_mm"])
def test_a_missing_nominal_view_is_refused_by_its_key(key: str) -> None:
    with pytest.raises(InputError, match=rf"cameras\.3\.{key} is missing; without it the marks in its view"):
        nominal_matrix(head(**{key: None}), 3)


def test_the_reach_is_limited_by_the_view_and_by_a_fixed_distance() -> None:
    assert reach_mm(head()) == pytest.approx(0.45 * 18)
    assert reach_mm(head(nominal_px_per_mm=2.0)) == REACH_MM


def test_the_border_belongs_to_the_frame_and_a_margin_moves_it() -> None:
    px = np.array([[0, 0], [479, 359], [479.1, 5], [5, -0.1], [-9, -9]])
    assert is_in_frame(head(), px).tolist() == [True, True, False, False, False]
    assert is_in_frame(head(), px, 1.0).tolist() == [False] * 5
    assert is_in_frame(head(), px, -10.0).tolist() == [True] * 5


def test_marks_in_view_are_those_of_the_nominal_field_and_its_slack() -> None:
    marks = np.array([[30.0, -2.0], [41.9, -2.0], [42.5, -2.0], [30.0, 8.0], [60.0, 0.0]])
    assert marks_in_view(head(), 0, marks).tolist() == [0, 1]
    assert marks_in_view(head(), 0, marks, slack_mm=2.0).tolist() == [0, 1, 2, 3]

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.plausibility import find_implausibility
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

HEAD = CameraHead(width=1392, height=1040, exposure_us=1.0, nominal_center_mm=(0.0, 0.0), nominal_px_per_mm=40.0)


def _view(x: float = 40.0, y: float = 40.0, tilt_per_mm: float = 0.0) -> Floats:
    middle = np.array([[1, 0, 695.5], [0, 1, 519.5], [0, 0, 1]])
    return np.asarray(middle @ np.array([[x, 0, 0], [0, y, 0], [tilt_per_mm, 0, 1.0]]))


@pytest.mark.parametrize(
    ("matrix", "reason"),
    [
        (_view(44, 44), "44.00 px/mm, more than 8% off the nominal 40.00"),
        (_view(40.4, 40.0), "stretched by 1.00% in one direction"),
        (_view(40, -40), "mirrored"),
        (_view(40, 40, 4e-4), "changes by 1.4% over the frame, but a camera 483 mm away that is tilted by at most 6°"),
        (_view(40, 40, 0.06), "horizon"),
    ],
)
def test_impossible_views_are_refused(matrix: Floats, reason: str) -> None:
    said = find_implausibility(matrix, HEAD, 483.0)
    assert said is not None
    assert reason in said

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.layout_variants import vary_layout
from vaoi_station.model import CameraHead

GRID = np.stack(np.meshgrid([0.0, 4, 8], [0.0, 3, 6]), -1).reshape(-1, 2)
HEADS = tuple(
    CameraHead(width=480, height=360, exposure_us=1.0, nominal_center_mm=(x, 5.0), nominal_px_per_mm=20.0)
    for x in (20.0, 40.0)
)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("mirrored in x", lambda p: p * (-1, 1)),
        ("mirrored in y", lambda p: p * (1, -1)),
        ("turned by 180°", lambda p: -p),
        ("with x and y exchanged", lambda p: p[:, ::-1]),
        ("turned by 90°", lambda p: p[:, ::-1] * (-1, 1)),
        ("turned by -90°", lambda p: p[:, ::-1] * (1, -1)),
    ],
)
def test_each_mistake_about_the_origin_is_among_the_variants(name: str, change: object) -> None:
    layout = GRID + (1.5, 2.5)
    expected = change(layout)  # type: ignore[operator]
    assert any(n == name and np.allclose(v, expected) for n, v in vary_layout(layout, HEADS))


def test_the_last_variant_is_shifted_to_the_centre_of_the_array() -> None:
    name, shifted = list(vary_layout(GRID, HEADS))[-1]
    assert name == "shifted by (26.0, 2.0) mm"
    assert (shifted.min(0) + shifted.max(0)) / 2 == pytest.approx((30.0, 5.0))

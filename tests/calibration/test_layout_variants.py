from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.calibration.layout_variants import find_symmetries, vary_layout
from vaoi_station.model import CameraHead

GRID = np.stack(np.meshgrid([0.0, 4, 8], [0.0, 3, 6]), -1).reshape(-1, 2)
HEADS = tuple(
    CameraHead(width=480, height=360, exposure_us=1.0, nominal_center_mm=(x, 5.0), nominal_px_per_mm=20.0)
    for x in (20.0, 40.0)
)


def test_a_rectangular_grid_is_its_own_reflection_and_half_turn() -> None:
    assert find_symmetries(GRID, 0.1) == ("mirrored in x", "mirrored in y", "turned by 180°")


def test_a_square_grid_has_all_symmetries() -> None:
    assert len(find_symmetries(GRID * (3, 4), 0.1)) == 6


def test_one_mark_off_the_pattern_breaks_all_symmetries() -> None:
    assert find_symmetries(np.vstack([GRID, [[1.0, 1.0]]]), 0.1) == ()


@given(st.floats(-500, 500), st.floats(-500, 500))
def test_symmetries_do_not_depend_on_the_origin(x: float, y: float) -> None:
    assert find_symmetries(GRID + (x, y), 0.1) == find_symmetries(GRID, 0.1)


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


def test_no_variant_of_one_mistake_comes_twice() -> None:
    layout = GRID - GRID.mean(0)
    seen: dict[str, list[np.ndarray]] = {}
    for name, variant in vary_layout(layout, HEADS):
        assert not any(np.allclose(variant, v) for v in seen.get(name, []))
        seen.setdefault(name, []).append(variant)

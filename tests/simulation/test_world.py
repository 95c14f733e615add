"""The world of a scenario is consistent: calibration, heads, line, textures, light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.simulation import Twin

Make = Callable[..., Twin]


@pytest.mark.parametrize(("distortion_px", "present"), [(0.0, False), (1.5, True)])
def test_distortion_is_stated_only_where_lenses_distort(make: Make, distortion_px: float, present: bool) -> None:
    twin = make(array={"distortion_px": distortion_px})
    assert (twin.calibration.distortion is not None) == present


def test_calibrated_cameras_project_like_the_real_ones(make: Make) -> None:
    twin = make(array={"cameras": 2, "distortion_px": 1.5, "tilt_deg": 0.5})
    for camera, pinhole in zip(twin.cameras, twin.pinholes, strict=True):
        places = np.random.default_rng(1).uniform(-5, 5, (30, 2)) + pinhole.foot_mm
        assert np.abs(camera.project(places) - pinhole.project(places, 0.0)).max() < 1e-6


def test_heads_state_the_nominal_array(make: Make) -> None:
    twin = make(array={"cameras": 3, "exposures_us": [1.0, 2.0], "position_mm": 5.0})
    pitch = twin.scenario.array.pitch_mm
    assert [head.nominal_center_mm for head in twin.heads] == [(0.0, 0.0), (pitch, 0.0), (2 * pitch, 0.0)]
    assert [head.exposure_us for head in twin.heads] == [1.0, 2.0, 1.0]
    assert {(head.width, head.height, head.nominal_px_per_mm) for head in twin.heads} == {(160, 120, 10.0)}


def test_twins_of_one_board_share_its_artwork(make: Make) -> None:
    first, again, other = make(), make(array={"cameras": 2}), make(board={"seed": 6})
    assert first.artwork is again.artwork
    assert first.artwork is not other.artwork


def test_a_light_from_one_side_brightens_that_side(make: Make) -> None:
    lights = {"ring": {"azimuth_deg": 90.0, "shading": 0.4}, "flat": {}}
    twin = make(line={"lights": ["ring", "flat"]}, lights=lights)
    shade = twin.shade(0, "ring")
    assert shade.shape == (120, 160)
    assert float(shade[-1].mean() - shade[0].mean()) == pytest.approx(0.4, rel=0.01)
    assert np.ptp(shade.mean(0)) < 1e-5
    assert np.allclose(twin.shade(0, "flat"), 1.0)

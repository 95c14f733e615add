"""The world of a scenario is consistent: calibration, heads, line, textures, light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.simulation import Twin
from vaoi_station.simulation.world import TEXTURE_PER_PIXEL

Make = Callable[..., Twin]


def test_the_calibration_is_that_of_the_mounted_cameras(small: Twin) -> None:
    assert len(small.calibration.camera_matrices) == small.scenario.array.cameras
    for matrix, pinhole in zip(small.calibration.camera_matrices, small.pinholes, strict=True):
        assert np.array_equal(matrix, pinhole.plane())
    assert small.calibration.working_distance_mm == small.scenario.array.working_distance_mm


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


def test_the_texture_is_finer_than_the_frames(small: Twin) -> None:
    assert small.artwork.px_per_mm == TEXTURE_PER_PIXEL * small.scenario.array.px_per_mm
    assert small.parts == small.artwork.parts
    assert [component.ref for component in small.board_type.components] == [part.ref for part in small.parts]


def test_twins_of_one_board_share_its_artwork(make: Make) -> None:
    first, again, other = make(), make(array={"cameras": 2}), make(board={"seed": 6})
    assert first.artwork is again.artwork
    assert first.artwork is not other.artwork


def test_textures_and_shades_are_computed_once(small: Twin) -> None:
    assert small.paint("ring", np.eye(3)) is small.paint("ring", np.eye(3))
    assert small.shade(0, "ring") is small.shade(0, "ring")
    assert small.shade(0, "ring") is not small.shade(1, "ring")


def test_a_light_from_one_side_brightens_that_side(make: Make) -> None:
    lights = {"ring": {"azimuth_deg": 90.0, "shading": 0.4}, "flat": {}}
    twin = make(line={"lights": ["ring", "flat"]}, lights=lights)
    shade = twin.shade(0, "ring")
    assert shade.shape == (120, 160)
    assert float(shade[-1].mean() - shade[0].mean()) == pytest.approx(0.4, rel=0.01)
    assert np.ptp(shade.mean(0)) < 1e-5
    assert np.allclose(twin.shade(0, "flat"), 1.0)


def test_an_unknown_light_is_an_error(small: Twin) -> None:
    with pytest.raises(KeyError, match="dome"):
        small.paint("dome", np.eye(3))


def test_the_line_is_that_of_the_scenario(small: Twin) -> None:
    line, section = small.line, small.scenario.line
    assert line.conveyor_mm_s == (0.0, small.scenario.belt.speed_mm_s)
    assert (line.start_delay_s, line.trigger_period_s, line.tail_s) == (
        section.start_delay_s, section.period_s, section.tail_s,
    )  # fmt: skip

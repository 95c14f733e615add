from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.photometry.white_recordings import DARK, EXPOSURE_US, HEIGHT, READ, SHOT, WIDTH, film, shade, white
from vaoi_station.errors import InputError
from vaoi_station.photometry.measurement import (
    combine,
    measure_darkness,
    measure_flat_fields,
)


def test_one_field_per_camera_and_light_from_four_rows_each(tmp_path: Path) -> None:
    lights = ("even", "left", "right")
    recording = film(tmp_path / "white", white(120), lights=lights, rows=12)
    found = measure_flat_fields(recording, film(tmp_path / "dark", white(0), lights=(), rows=4))
    assert found.document is not None
    assert found.lights == lights
    everything = np.mean([shade(camera, light) for camera in (0, 1) for light in lights])
    for camera in (0, 1):
        for light in lights:
            maps = found.maps(camera, light)
            assert maps.flat is not None
            error = maps.flat / (shade(camera, light) / everything) - 1
            assert float(np.sqrt((error**2).mean())) < 0.004
            assert maps.dark == pytest.approx(DARK, abs=0.05)
        noise = found.document.cameras[camera]
        assert noise.read == pytest.approx(READ, abs=0.06)
        assert noise.shot == pytest.approx(SHOT, rel=0.15)
    assert np.mean([flat.mean() for flat in found.flats.values()]) == pytest.approx(1, abs=1e-3)
    assert [head.rows for head in found.document.fields] == [4] * 6
    level = 120 / EXPOSURE_US * shade(0, "left").mean()
    assert found.document.fields[1].level == pytest.approx(level, rel=0.005)


def test_rows_that_do_not_suit_are_left_out(tmp_path: Path) -> None:
    # Rows in turn 1 : 0.05, as a program for several exposures takes them.
    exposures = [[EXPOSURE_US * (0.05 if row % 2 else 1.0)] * 2 for row in range(8)]
    gains = [[1.0, 0.5]] * 8
    taken = film(tmp_path / "white", white(120), rows=8, exposures_us=exposures, gains=gains)
    found = measure_flat_fields(taken, film(tmp_path / "dark", white(0)))
    assert found.document is not None
    assert {head.rows for head in found.document.fields} == {4}
    assert found.document.fields[1].level == pytest.approx(120 / EXPOSURE_US * shade(1).mean(), rel=0.01)


def board(_camera: int, row: int) -> Any:
    pattern = np.kron(np.random.default_rng(7).uniform(0.2, 1, (HEIGHT // 8, WIDTH // 8)), np.ones((8, 8)))
    return np.roll(pattern, 12 * row, 0) * 150 / EXPOSURE_US


@pytest.mark.parametrize(
    ("scene", "options", "message"),
    [
        (white(400), {}, r"camera 0: \d+\.\d% of the pixels are saturated, but at most 0\.1% may be; 0 of at least 4"),
        (
            white(9),
            {},
            r"camera 0: is too dark: the white target is \d+\.\d grey levels above the dark level",
        ),
        (board, {}, r"camera 0: the picture is structured: its brightness differs by \d\d\.\d% rms from row to row"),
        (lambda c, _: board(c, 0), {}, r"structured: its brightness differs by .*% rms from a smooth surface"),
        (white(120), {"rows": 3}, "camera 0: has 3 rows, but a flat field needs at least 4 for each light"),
        (white(120), {"lights": ("a", "b"), "rows": 7}, "camera 0, light 'b': has 3 rows, but a flat field needs"),
        (white(120), {"missing": ((1, 2),)}, "camera 1: has 3 rows, but a flat field needs at least 4"),
        (lambda _, r: white(150 if r % 2 else 60)(0, 0), {}, r"brightness of a row differs by \d\d% from the median"),
        (
            lambda _, __: np.linspace(-40, 200, WIDTH).clip(0)[None].repeat(HEIGHT, 0) / EXPOSURE_US,
            {},
            r"darkest part of the frame has .*% of the mean brightness, but .* 5%",
        ),
    ],
)
def test_unfit_targets_are_refused_with_numbers(tmp_path: Path, scene: Any, options: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        measure_flat_fields(film(tmp_path, scene, **options))


@pytest.mark.parametrize(("level", "sigma"), [(2.0, 1.5), (0.5, 1.0), (20.0, 2.0)])
def test_the_dark_level_is_right_although_grey_levels_are_cut_off_at_zero(level: float, sigma: float) -> None:
    rng = np.random.default_rng(1)
    frames = [np.clip(np.round(rng.normal(level, sigma, (96, 128))), 0, 255).astype(np.float32) for _ in range(4)]
    found = measure_darkness(frames)
    assert found.level == pytest.approx(level, abs=0.06)
    assert found.read == pytest.approx(sigma, abs=0.06)
    assert found.map is None


def test_dark_columns_and_hot_pixels_are_kept_in_a_map() -> None:
    rng = np.random.default_rng(2)
    pattern = np.full((96, 128), 5.0)
    pattern[:, 64:] += 2.0
    pattern[30, 40] = 60.0
    frames = [np.round(pattern + rng.normal(0, 1.0, pattern.shape)).clip(0).astype(np.float32) for _ in range(8)]
    found = measure_darkness(frames)
    assert found.map is not None
    assert found.map[:, 90:].mean() - found.map[:, :40].mean() == pytest.approx(2.0, abs=0.1)
    assert found.map[30, 40] == pytest.approx(60, abs=4)


H, W = 96, 128


def rows(count: int, pattern: NDArray[np.float64], seed: int = 1) -> list[NDArray[np.float32]]:
    rng = np.random.default_rng(seed)
    noise = np.sqrt(1.5**2 + 0.03 * pattern)
    return [(pattern + rng.standard_normal(pattern.shape) * noise).astype(np.float32) for _ in range(count)]


def vignette() -> NDArray[np.float64]:
    x, y = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    return np.asarray(150 * (1 - 0.2 * (x**2 + y**2)))


def test_dust_on_the_lens_stays_and_dust_on_the_target_goes() -> None:
    pattern = vignette()
    pattern[20:24, 30:34] *= 0.8
    taken = rows(6, pattern)
    taken[2][60:64, 80:84] *= 0.5
    found = combine(taken, [250.0] * 6).surface * 250 / vignette()
    assert found[21:23, 31:33].mean() == pytest.approx(0.8, abs=0.02)
    assert found[60:64, 80:84].mean() == pytest.approx(1.0, abs=0.01)

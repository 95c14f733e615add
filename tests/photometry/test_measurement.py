from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.photometry.white_recordings import DARK, EXPOSURE_US, HEIGHT, READ, SHOT, WIDTH, film, shade, white
from vaoi_station.errors import InputError
from vaoi_station.files import open_recording
from vaoi_station.photometry.measurement import measure_flat_fields


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


def test_without_darkness_the_dark_level_is_zero_and_noise_is_fitted(tmp_path: Path) -> None:
    found = measure_flat_fields(film(tmp_path, white(150), rows=6))
    assert found.document is not None
    assert found.lights == (None,)
    assert found.maps(0, None).dark == 0
    noise = found.maps(0, None).noise
    assert noise.read**2 + noise.shot * 150 == pytest.approx(READ**2 + SHOT * 150, rel=0.15)


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
    ],
)
def test_unfit_targets_are_refused_with_numbers(tmp_path: Path, scene: Any, options: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        measure_flat_fields(film(tmp_path, scene, **options))


def test_a_frame_that_the_lamp_does_not_reach_is_refused(tmp_path: Path) -> None:
    def scene(_camera: int, _row: int) -> Any:
        return np.linspace(-40, 200, WIDTH).clip(0)[None].repeat(HEIGHT, 0) / EXPOSURE_US

    with pytest.raises(InputError, match=r"darkest part of the frame has .*% of the mean brightness, but .* 5%"):
        measure_flat_fields(film(tmp_path, scene))


@pytest.mark.parametrize(
    ("level", "options", "message"),
    [
        (150, {}, r"camera 0 has a dark level of 1\d\d grey levels, but it must be at most 64"),
        (0, {"rows": 2}, "has 2 rows of camera 0, but darkness needs at least 4"),
        (0, {"cameras": 1}, "has 1 cameras of 128×96 px, but .* has 2 of 128×96, 128×96 px"),
    ],
)
def test_unfit_darkness_is_refused_with_numbers(tmp_path: Path, level: float, options: Any, message: str) -> None:
    targets = film(tmp_path / "white", white(150)), film(tmp_path / "dark", white(level), **options)
    with pytest.raises(InputError, match=message):
        measure_flat_fields(*targets)


def test_fields_state_the_serial_numbers_of_their_cameras(tmp_path: Path) -> None:
    film(tmp_path / "white", white(150))
    path = tmp_path / "white" / "recording.json"
    head = json.loads(path.read_text())
    head["cameras"][1]["serial"] = "A2"
    path.write_text(json.dumps(head))
    made = measure_flat_fields(open_recording(tmp_path / "white")).document
    assert made is not None
    assert [camera.serial for camera in made.cameras] == [None, "A2"]

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.files.images import encode_tiff
from vaoi_station.model import CameraHead
from vaoi_station.photometry.flat_fields import FlatFieldDocument, FlatFields, write_flat_fields
from vaoi_station.photometry.noise import NoiseModel

LIGHTS = ("even", "left")


def fields(lights: tuple[str | None, ...] = LIGHTS, *, dark_map: bool = True) -> FlatFields:
    rng = np.random.default_rng(3)
    keys = [(camera, light) for camera in range(2) for light in lights]
    dark: dict[str, Any] = {"dark_file": "fields/c00_dark.tiff"} if dark_map else {}
    size = {"width": 20, "height": 16, "dark": 2.0, "read": 1.5, "shot": 0.03}
    document = {
        "format": "vaoi-flatfield",
        "version": 1,
        "cameras": [size | dark, size],
        "fields": [
            {"camera": c, "light": light, "file": f"fields/c{c:02d}_{light}.tiff", "level": 0.6, "rows": 4}
            for c, light in keys
        ],
    }
    return FlatFields(
        FlatFieldDocument.model_validate(document),
        {key: rng.uniform(0.7, 1.3, (16, 20)).astype(np.float32) for key in keys},
        {0: rng.uniform(1, 3, (16, 20)).astype(np.float32)} if dark_map else {},
    )


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    write_flat_fields(tmp_path, fields())
    return tmp_path


def heads(cameras: int = 2, width: int = 20) -> list[CameraHead]:
    return [CameraHead(width=width, height=16, exposure_us=250.0)] * cameras


def test_what_was_written_is_read(stored: Path) -> None:
    found, made = FlatFields.open(stored), fields()
    assert found.lights == LIGHTS
    for camera in (0, 1):
        for light in LIGHTS:
            a, b = found.maps(camera, light), made.maps(camera, light)
            np.testing.assert_array_equal(a.flat, b.flat)
            np.testing.assert_array_equal(a.dark, b.dark)
            assert a.noise == NoiseModel(1.5, 0.03)
    assert found.maps(1, "left").dark == 2.0
    found.check(heads(), ["left", "even", "left"])


@pytest.mark.parametrize(
    ("cameras", "lights", "message"),
    [
        (heads(3), ["even"], "are of an array of 2 cameras, but 3 cameras were filming"),
        (heads(width=24), ["even"], "camera 0 has 20×16 px, but its frames have 24×16 px"),
        (heads(), ["even", "ring"], "no field for the light 'ring'; there are 2: 'even', 'left'"),
        (heads(), None, "no field for frames without a named light; there are 2"),
    ],
)
def test_another_array_resolution_or_light_is_refused(
    stored: Path, cameras: list[CameraHead], lights: list[str] | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        FlatFields.open(stored).check(cameras, lights)


def test_cameras_of_other_serial_numbers_are_refused_where_both_are_known(stored: Path) -> None:
    """Two arrays of one kind have the same number of cameras and the same frames; so have two exchanged cameras."""

    def of(*serials: str | None) -> list[CameraHead]:
        return [head.model_copy(update={"serial": serial}) for head, serial in zip(heads(), serials, strict=True)]

    FlatFields.peek(stored).check(of("A1", "A2"), LIGHTS)
    cameras = json.loads((stored / "flatfield.json").read_text())["cameras"]
    change("cameras", [camera | {"serial": s} for camera, s in zip(cameras, ("A1", "A2"), strict=True)])(stored)
    known = FlatFields.peek(stored)
    for same in (of("A1", "A2"), of("A1", None), of(None, None)):
        known.check(same, LIGHTS)
    with pytest.raises(InputError, match="camera 1 is that of serial number A2, but its frames are of B2"):
        known.check(of("A1", "B2"), LIGHTS)


def test_the_age_is_that_of_the_white_target(stored: Path) -> None:
    now = datetime(2026, 7, 1, tzinfo=UTC)
    assert FlatFields.peek(stored).age_days(now) is None
    change("created", "2026-06-21T00:00:00+00:00")(stored)
    assert FlatFields.peek(stored).age_days(now) == 10
    change("created", "in June")(stored)
    assert FlatFields.peek(stored).age_days(now) is None
    assert FlatFields.peek(stored).named_lights == LIGHTS
    assert fields((None,)).named_lights is None
    assert FlatFields.none().age_days(now) is None


def change(key: str, value: Any) -> Callable[[Path], None]:
    def apply(directory: Path) -> None:
        path = directory / "flatfield.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))

    return apply


def replace(content: bytes) -> Callable[[Path], None]:
    def apply(directory: Path) -> None:
        (directory / "fields" / "c00_even.tiff").write_bytes(content)

    return apply


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change("format", "vaoi-calibration"), "format is 'vaoi-calibration'"),
        (change("version", 2), "newer"),
        (change("lamp", 1), "unknown key"),
        (change("fields", []), "fields"),
        (lambda d: (d / "fields" / "c01_left.tiff").unlink(), "c01_left.tiff: cannot be read"),
        (replace(b"nothing"), "c00_even.tiff: is not a grey TIFF of 32-bit floats"),
        (replace(encode_tiff(np.zeros((16, 20), np.uint8))), "is not a grey TIFF of 32-bit floats"),
        (replace(encode_tiff(np.ones((4, 4), np.float32))), "is 4×4 px, but flatfield.json says 20×16 px"),
        (replace(encode_tiff(np.full((16, 20), np.nan, np.float32))), "range is"),
        (replace(encode_tiff(np.full((16, 20), -1, np.float32))), "range is '-1 to -1', but must be 0 to 1000"),
    ],
)
def test_damaged_fields_are_refused(stored: Path, damage: Callable[[Path], None], message: str) -> None:
    damage(stored)
    with pytest.raises(InputError, match=message):
        FlatFields.open(stored)

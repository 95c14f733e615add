"""The pictures of a virtual camera."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.rig.virtual_camera import BLACK_LEVEL, OWN_DESCRIPTION, apply_brightness, read_description

MONO_8, MONO_16 = 0x01080001, 0x01100007


@pytest.mark.parametrize(("code", "kind", "scale"), [(MONO_8, "u1", 1), (MONO_16, "<u2", 256)])
def test_light_multiplies_what_is_above_the_black_level(code: int, kind: str, scale: int) -> None:
    black, top = BLACK_LEVEL * scale, 256 * scale - 1
    pixels = np.array([0, black, black + 10 * scale, 200 * scale, top], kind)
    flat = pixels.view(np.uint8)
    assert apply_brightness(flat, 1.0, code) is flat
    half = apply_brightness(flat, 0.5, code).view(kind).tolist()
    assert half == [black // 2, black, black + 5 * scale, 101 * scale, round(black + (top - black) / 2)]
    assert apply_brightness(flat, 0.0, code).view(kind).tolist() == [black] * 5
    assert apply_brightness(flat, 100.0, code).view(kind).tolist()[2:] == [top] * 3


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("cut.xml", OWN_DESCRIPTION.read_bytes()[:900], "cannot be parsed"),
        ("other.xml", b"<html/>", "no element RegisterDescription"),
        ("cut.xml.gz", gzip.compress(OWN_DESCRIPTION.read_bytes())[:200], "ended before"),
        ("plain.xml.gz", OWN_DESCRIPTION.read_bytes(), "Not a gzipped file"),
        ("missing.xml", None, "No such file"),
    ],
)
def test_a_file_that_is_no_description_is_refused_by_its_name(
    tmp_path: Path, name: str, content: bytes | None, why: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=rf"{name}: cannot be read as the description of a camera: .*{why}"):
        read_description(path)


def test_a_packed_description_is_read_as_the_plain_one(tmp_path: Path) -> None:
    packed = tmp_path / "camera.xml.gz"
    packed.write_bytes(gzip.compress(OWN_DESCRIPTION.read_bytes()))
    assert read_description(packed) == read_description(OWN_DESCRIPTION)

"""What a virtual camera does with its pictures, its orders and its description; on the wire: `test_wire.py`."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.rig.virtual_camera import BLACK_LEVEL, apply_brightness

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

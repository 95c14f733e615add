"""The description and the pictures of a virtual camera."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest

from vaoi_station.rig.virtual_camera import (
    BLACK_LEVEL,
    apply_brightness,
    with_line0_trigger,
)

DESCRIPTION = """<RegisterDescription>
<Enumeration Name="Other"><EnumEntry Name="Line0"><Value>0</Value></EnumEntry></Enumeration>
<Enumeration Name="TriggerSource" NameSpace="Standard">
<EnumEntry Name="Line0" NameSpace="Standard"><Value>0</Value></EnumEntry>
<EnumEntry Name="Software" NameSpace="Standard"><Value>1</Value></EnumEntry>
</Enumeration>
</RegisterDescription>
"""


def numbers(description: str, enumeration: str) -> dict[str, int]:
    """Name → number of the entries of one enumeration."""
    root = ET.fromstring(description)
    [found] = [e for e in root.iter("Enumeration") if e.get("Name") == enumeration]
    return {str(entry.get("Name")): int(entry.findtext("Value") or "") for entry in found.iter("EnumEntry")}


def test_only_the_trigger_sources_change_places() -> None:
    changed = with_line0_trigger(DESCRIPTION)
    assert numbers(changed, "TriggerSource") == {"Line0": 1, "Software": 0}
    assert numbers(changed, "Other") == {"Line0": 0}


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

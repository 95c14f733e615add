"""What a virtual camera does with its pictures, its orders and its description; on the wire: `test_wire.py`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError, InternalError
from vaoi_station.rig.devices.camera_commands import TriggerCommand
from vaoi_station.rig.devices.camera_description import with_line0_trigger
from vaoi_station.rig.devices.network import addresses
from vaoi_station.rig.devices.virtual_camera import BLACK_LEVEL, apply_brightness

MONO_8, MONO_16 = 0x01080001, 0x01100007
SOURCES = """<RegisterDescription>
<Enumeration Name="Other"><EnumEntry Name="Line0"><Value>0</Value></EnumEntry></Enumeration>
<Enumeration Name="TriggerSource" NameSpace="Standard">
<EnumEntry Name="Line0" NameSpace="Standard"><Value>0</Value></EnumEntry>
<EnumEntry Name="Software" NameSpace="Standard"><Value>1</Value></EnumEntry>
</Enumeration>
</RegisterDescription>
"""


@given(
    st.builds(
        TriggerCommand,
        st.integers(-1, 10**6),
        st.integers(0, 2**63),
        st.floats(0, 8),
        st.floats(0, 1),
    )
)
def test_an_order_is_understood_as_it_was_meant(command: TriggerCommand) -> None:
    assert TriggerCommand.from_line(command.to_line()) == command


def test_only_the_trigger_sources_change_places() -> None:
    changed = with_line0_trigger(SOURCES)
    other, source = changed.split('<Enumeration Name="TriggerSource"')
    assert 'Name="Line0"><Value>0</Value>' in other
    assert 'Name="Line0" NameSpace="Standard"><Value>1</Value>' in source
    assert 'Name="Software" NameSpace="Standard"><Value>0</Value>' in source
    assert source.index('Name="DeviceTemperature"') < source.index("</RegisterDescription>")


@pytest.mark.parametrize("gone", ['Name="TriggerSource"', 'Name="Line0" NameSpace', 'Name="Software"'])
def test_another_description_is_refused(gone: str) -> None:
    with pytest.raises(InternalError, match="Aravis' fake camera has no"):
        with_line0_trigger(SOURCES.replace(gone, 'Name="Else" NameSpace'))


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


def test_every_camera_has_an_address_of_its_own() -> None:
    assert addresses(3) == ("127.0.0.2", "127.0.0.3", "127.0.0.4")
    assert len(set(addresses(200))) == 200
    for count in (0, 201):
        with pytest.raises(InputError, match=f"--cameras is {count}, but must be from 1 to 200"):
            addresses(count)

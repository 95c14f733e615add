"""The fake camera's description waits for Line0 after the change, and is otherwise the same."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InternalError
from vaoi_station.rig.virtual_camera import EXPOSURE_MODE_ADDRESS, TIMED, TRIGGER_WIDTH, with_line0_trigger

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


@given(st.integers(0, 999), st.integers(0, 999))
def test_any_two_numbers_are_exchanged(line: int, software: int) -> None:
    description = DESCRIPTION.replace(
        'Standard"><Value>0</Value>', f'Standard"><Value>{line}</Value>'
    ).replace('Standard"><Value>1</Value>', f'Standard"><Value>{software}</Value>')  # fmt: skip
    before = numbers(description, "TriggerSource")
    assert numbers(with_line0_trigger(description), "TriggerSource") == {
        "Line0": before["Software"],
        "Software": before["Line0"],
    }


def test_a_thermometer_and_the_exposure_mode_are_added_at_the_end() -> None:
    root = ET.fromstring(with_line0_trigger(DESCRIPTION, celsius=37.25))
    [thermometer] = [e for e in root if e.get("Name") == "DeviceTemperature"]
    assert float(thermometer.findtext("Value") or "") == 37.25
    names = [e.get("Name") for e in root][-3:]
    assert names == ["DeviceTemperature", "ExposureMode", "ExposureModeRegister"]


def test_the_exposure_mode_lies_in_a_register_of_its_own() -> None:
    changed = with_line0_trigger(DESCRIPTION)
    assert numbers(changed, "ExposureMode") == {"Timed": TIMED, "TriggerWidth": TRIGGER_WIDTH}
    assert f"<Address>{EXPOSURE_MODE_ADDRESS}</Address>" in changed


def test_everything_else_stays_as_it_was() -> None:
    changed = with_line0_trigger(DESCRIPTION)
    without = re.sub(r"\s*<Float Name=\"DeviceTemperature\".*</IntReg>\s*", "\n", changed, flags=re.DOTALL)
    assert re.sub(r"<Value>\d</Value>", "", without) == re.sub(r"<Value>\d</Value>", "", DESCRIPTION)


@pytest.mark.parametrize("missing", ['Name="TriggerSource"', 'Name="Line0" NameSpace', 'Name="Software"'])
def test_another_description_is_refused(missing: str) -> None:
    with pytest.raises(InternalError, match="Aravis' fake camera has no"):
        with_line0_trigger(DESCRIPTION.replace(missing, 'Name="Else" NameSpace'))


def test_a_description_that_is_cut_off_is_refused() -> None:
    with pytest.raises(InternalError, match="has no TriggerSource"):
        with_line0_trigger(DESCRIPTION.split("</Enumeration>\n</Register", maxsplit=1)[0])

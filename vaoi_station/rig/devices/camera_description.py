"""Change the GenICam description of Aravis' fake camera: a hardware trigger on Line0, and exposure by its width.

The fake accepts a trigger only while its trigger source register holds the number of the entry *Software*; a program
then triggers it by writing a register. This module exchanges the numbers of the entries *Line0* and *Software*. A
client that selects Line0 reads Line0 back, but has selected the source that the rig triggers. A client that triggers by
software has no effect. The feature ExposureMode (SFNC) lies in a register that the fake does not use, and that the rig
reads.
"""

from __future__ import annotations

import re

from vaoi_station.errors import InternalError

_ENTRY = r'(<EnumEntry Name="{}"[^>]*>.*?<Value>)(\d+)(</Value>)'
_TEMPERATURE = """
	<Float Name="DeviceTemperature" NameSpace="Standard">
		<DisplayName>Device Temperature</DisplayName>
		<Value>{celsius}</Value>
		<Unit>C</Unit>
	</Float>
"""

EXPOSURE_MODE_ADDRESS = 0x9000
"""Address of the register that holds the ExposureMode, in the fake's memory beyond its own registers."""
TIMED, TRIGGER_WIDTH = 0, 1
"""Values of that register."""
_EXPOSURE_MODE = f"""
	<Enumeration Name="ExposureMode" NameSpace="Standard">
		<DisplayName>Exposure Mode</DisplayName>
		<EnumEntry Name="Timed" NameSpace="Standard"><Value>{TIMED}</Value></EnumEntry>
		<EnumEntry Name="TriggerWidth" NameSpace="Standard"><Value>{TRIGGER_WIDTH}</Value></EnumEntry>
		<pValue>ExposureModeRegister</pValue>
	</Enumeration>
	<IntReg Name="ExposureModeRegister" NameSpace="Custom">
		<Address>{EXPOSURE_MODE_ADDRESS}</Address>
		<Length>4</Length>
		<AccessMode>RW</AccessMode>
		<pPort>Device</pPort>
		<Sign>Unsigned</Sign>
		<Endianess>BigEndian</Endianess>
	</IntReg>
"""


def with_line0_trigger(description: str, celsius: float = 41.5) -> str:
    """Return the fake's GenICam description with Line0 as the working trigger source, a temperature and ExposureMode.

    Raises:
        InternalError: this version of Aravis describes its fake camera differently.
    """
    head, source, rest = _split(description)
    line, software = (_number(source, name) for name in ("Line0", "Software"))
    # Between the two replacements both entries have the same number, so each entry is found by its name.
    source = _with_number(_with_number(source, "Line0", software), "Software", line)
    end = rest.rindex("</RegisterDescription>")
    return head + source + rest[:end] + _TEMPERATURE.format(celsius=celsius) + _EXPOSURE_MODE + rest[end:]


def _split(description: str) -> tuple[str, str, str]:
    """Split a description into three texts: before, inside, and after the enumeration of trigger sources."""
    start = description.find('<Enumeration Name="TriggerSource"')
    end = description.find("</Enumeration>", start)
    if start < 0 or end < 0:
        raise InternalError("Aravis' fake camera has no TriggerSource.")
    return description[:start], description[start:end], description[end:]


def _number(source: str, name: str) -> int:
    """Return the number of a trigger source in the enumeration `source`, a part of the description."""
    found = re.search(_ENTRY.format(name), source, re.DOTALL)
    if found is None:
        raise InternalError(f"Aravis' fake camera has no trigger source {name}.")
    return int(found[2])


def _with_number(source: str, name: str, number: int) -> str:
    """Return the enumeration `source` with another number for the trigger source `name`."""
    return re.sub(_ENTRY.format(name), rf"\g<1>{number}\g<3>", source, count=1, flags=re.DOTALL)

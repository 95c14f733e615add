"""Aravis' fake camera, made to wait for a wired trigger: its description is changed in memory.

The fake fires only while its trigger source has the number that its own description calls *Software*, and a program
fires it by a register. So the numbers of the entries *Line0* and *Software* change places: a client that selects Line0
and reads Line0 back has selected what we fire, and one that fires by software fires nothing.
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


def wired(description: str, celsius: float = 41.5) -> str:
    """The fake's GenICam description with Line0 as the trigger that works, and a thermometer.

    Raises:
        InternalError: this version of Aravis describes its fake camera in another way.
    """
    head, source, rest = _split(description)
    line, software = (_number(source, name) for name in ("Line0", "Software"))
    source = _renumbered(_renumbered(source, "Line0", software), "Software", line)
    end = rest.rindex("</RegisterDescription>")
    return head + source + rest[:end] + _TEMPERATURE.format(celsius=celsius) + rest[end:]


def _split(description: str) -> tuple[str, str, str]:
    """What comes before, in and after the enumeration of trigger sources."""
    start = description.find('<Enumeration Name="TriggerSource"')
    end = description.find("</Enumeration>", start)
    if start < 0 or end < 0:
        raise InternalError("Aravis' fake camera has no TriggerSource.")
    return description[:start], description[start:end], description[end:]


def _number(source: str, name: str) -> int:
    found = re.search(_ENTRY.format(name), source, re.DOTALL)
    if found is None:
        raise InternalError(f"Aravis' fake camera has no trigger source {name}.")
    return int(found[2])


def _renumbered(source: str, name: str, number: int) -> str:
    return re.sub(_ENTRY.format(name), rf"\g<1>{number}\g<3>", source, count=1, flags=re.DOTALL)

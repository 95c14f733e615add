"""What the stand-in makes up where a description leaves it to the camera: presence, limits, values."""

from __future__ import annotations

from vaoi_station.rig.gige.description import Description, Features
from vaoi_station.rig.gige.device import Registers
from vaoi_station.rig.gige.first_values import FirstValues, Sensor


def register(name: str, address: int, bit: int | None = None) -> str:
    tag, bits = ("IntReg", "") if bit is None else ("MaskedIntReg", f"<Bit>{bit}</Bit>")
    return (
        f'<{tag} Name="{name}"><Address>{address:#x}</Address><Length>4</Length><AccessMode>RO</AccessMode>'
        f"<pPort>Device</pPort>{bits}<Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></{tag}>"
    )


def choice(name: str, *entries: str, condition: str = "", conditions: bool = False) -> str:
    inner = "".join(
        f'<EnumEntry Name="{e}">{f"<pIsImplemented>{e}Bit</pIsImplemented>" if conditions else ""}<Value>{k}</Value>'
        "</EnumEntry>"
        for k, e in enumerate(entries)
    )
    own = f"<pIsImplemented>{condition}</pIsImplemented>" if condition else ""
    return f'<Enumeration Name="{name}">{own}{inner}<pValue>{name}Register</pValue></Enumeration>'


def camera(*nodes: str, features: tuple[str, ...]) -> Features:
    listed = "".join(f"<pFeature>{name}</pFeature>" for name in features)
    text = f'<RegisterDescription><Category Name="Root">{listed}</Category>{"".join(nodes)}<Port Name="Device"/>'
    made = Features(Description(text + "</RegisterDescription>"), Registers())
    FirstValues(made, Sensor(640, 480)).write()
    return made


def test_all_entries_of_a_trigger_are_there_although_one_would_do_for_its_presence() -> None:
    """Mako_U-029B, whose formulas also name variables that they do not declare."""
    either = (
        '<IntSwissKnife Name="Either"><pVariable Name="OFF">OffBit</pVariable><pVariable Name="ON">OnBit</pVariable>'
        "<Formula>OFF || ON || UNDECLARED</Formula></IntSwissKnife>"
    )
    made = camera(
        choice("TriggerMode", "Off", "On", condition="Either", conditions=True),
        register("OffBit", 0x100, 0),
        register("OnBit", 0x104, 0),
        register("TriggerModeRegister", 0x108),
        either,
        features=("TriggerMode",),
    )
    assert [made.allows_entry("TriggerMode", entry) for entry in ("Off", "On")] == [True, True]


def test_a_size_that_is_its_own_limit_is_that_of_the_sensor() -> None:
    """Mako_U-029B."""
    own = "".join(f"<{tag}>Columns</{tag}>" for tag in ("pValue", "pMin", "pMax"))
    made = camera(f'<Integer Name="SensorWidth">{own}</Integer>', register("Columns", 0x100), features=("SensorWidth",))
    assert made.value("SensorWidth") == 640


def test_a_shutter_that_is_never_global_is_that_of_other_models() -> None:
    """Descriptions of Hikrobot are shared by cameras with both kinds of sensors."""
    made = camera(
        choice("SensorShutterMode", "Rolling", "GlobalReset", condition="ShutterBit"),
        register("ShutterBit", 0x100, 0),
        register("SensorShutterModeRegister", 0x104),
        features=("SensorShutterMode",),
    )
    assert not made.allows("SensorShutterMode", "pIsImplemented")


def test_a_usb3_camera_with_some_names_of_gige_vision_is_none_of_gige() -> None:
    """MV-CA013-A0UM."""
    text = '<RegisterDescription StandardNameSpace="{}"><Integer Name="GevX"/></RegisterDescription>'
    assert [Description(text.format(space)).is_gige for space in ("GEV", "USB")] == [True, False]

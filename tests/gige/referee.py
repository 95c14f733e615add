"""The reference implementation of GenApi over the registers of a camera: what a client of any make reads there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from vaoi_station.rig.gige.camera import Camera
from vaoi_station.rig.gige.device import Device


def _port(device: Device) -> Any:
    """Return what answers the reference from a device's memory."""
    from genicam import genapi  # not all environments have it: tests/needs.py

    class Port(genapi.AbstractPort):  # type: ignore[misc]
        def read(self, address: int, count: int) -> bytes:
            return device.read(address, count)

        def write(self, address: int, content: bytes) -> None:
            device.write(address, bytes(content))

        def get_access_mode(self) -> Any:
            return genapi.EAccessMode.RW

    return Port()


class Referee:
    """A node map of the reference over a device."""

    def __init__(self, device: Device) -> None:
        from genicam import genapi

        self._readable = (genapi.EAccessMode.RO, genapi.EAccessMode.RW)
        self._map = genapi.NodeMap()
        self._map.load_xml_from_string(device.description)
        self._map.connect(_port(device), "Device")

    def refresh(self) -> None:
        """Read all registers again."""
        self._map._invalidate_nodes()

    def select(self, at: Mapping[str, Any]) -> None:
        """Let selectors stand at entries."""
        for selector, entry in at.items():
            self._map.get_node(selector).value = entry

    def has(self, name: str) -> bool:
        """Whether a feature can be read now."""
        # Some makers give a category the name of a feature (AVT_GE1050C: Gain).
        is_value = bool(self._map.has_node(name)) and hasattr(type(self._map.get_node(name)), "value")
        return is_value and self._access(name) in self._readable

    def writable(self, name: str) -> bool:
        """Whether a feature can be written now."""
        return bool(self._map.has_node(name)) and self._access(name) == self._readable[1]

    def node(self, name: str) -> Any:
        """Return a feature."""
        return self._map.get_node(name)

    def value(self, name: str) -> Any:
        """Return the value of a feature: a bool, a number, or the name of an entry."""
        return self._map.get_node(name).value

    def entries(self, name: str) -> list[str]:
        """Return the entries that an enumeration offers now."""
        return [str(symbol) for symbol in self._map.get_node(name).symbolics]

    def differences(self, camera: Camera) -> Iterator[str]:
        """Yield the features whose value the stand-in itself makes of the description in another way."""
        from genicam import genapi

        for name in filter(self.has, camera.features.description.features()):
            try:
                wanted = self.value(name)
            except genapi.GenericException:  # a formula that divides by zero until a client has written more
                continue
            got = camera.value(name)
            same = got == wanted if isinstance(wanted, str) else abs(float(got) - wanted) <= 1e-6 * abs(wanted)
            if not same:
                yield f"{name}: {got!r}, the reference has {wanted!r}"

    def _access(self, name: str) -> Any:
        return self._map.get_node(name).node.get_access_mode()

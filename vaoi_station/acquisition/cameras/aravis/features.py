"""The features of a camera by name: whether it has them, of which kind they are, their values, limits and entries.

A description may declare a feature that its camera lacks (`pIsImplemented`), or that another feature switches off
(`pIsAvailable`): neither counts as present. A selector is written only when it stands elsewhere.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Iterator
from typing import Any, Literal

from vaoi_station.acquisition.cameras.aravis.library import aravis, glib_error

Kind = Literal["boolean", "choice", "integer", "float", "string", "command"]
Value = bool | int | float | str
At = tuple[tuple[str, str], ...]
"""Selectors and the entries at which they must stand while a feature is written or read."""
_VALUE = {"boolean": "boolean", "choice": "string", "integer": "integer", "float": "float", "string": "string"}
"""Kind → its word in the names of Aravis' functions, as in `set_integer_feature_value`."""
COMMAND_S = 1.0
"""Longest time for which a command that reports no end is waited for. What it did is read back in any case."""


class Features:
    """The features of one open camera."""

    def __init__(self, camera: Any) -> None:
        """Read nothing yet."""
        self._device = camera.get_device()
        self._kinds: dict[str, Kind | None] = {}
        self._chains: dict[str, list[str]] = {}
        self._selected: dict[str, str] = {}
        self._before: dict[str, str] = {}

    def kind(self, name: str) -> Kind | None:
        """Return the kind of a feature; None if the description has no such feature, or a mere category."""
        if name not in self._kinds:
            node, library = self._device.get_feature(name), aravis()
            # An enumeration is an integer to Aravis as well, so the narrower kinds come first.
            kinds: tuple[tuple[Any, Kind], ...] = (
                (library.GcCommand, "command"),
                (library.GcBoolean, "boolean"),
                (library.GcEnumeration, "choice"),
                (library.GcFloat, "float"),
                (library.GcInteger, "integer"),
                (library.GcString, "string"),
            )
            self._kinds[name] = next((kind for of, kind in kinds if node is not None and isinstance(node, of)), None)
        return self._kinds[name]

    def has(self, name: str) -> bool:
        """Return whether the camera has a feature, and offers it now."""
        if self.kind(name) is None:
            return False
        # A description whose own condition cannot be read does not offer the feature.
        try:
            return all(map(self._is_there, self._chain(name)))
        except glib_error() as error:
            require_answer(error)
            return False

    def _is_there(self, node: str) -> bool:
        return bool(self._device.is_feature_implemented(node) and self._device.is_feature_available(node))

    def _chain(self, name: str) -> list[str]:
        """Return a feature and the nodes from which its value comes.

        By GenApi, a feature is as available as the node of its value; Aravis looks at the feature alone
        (Basler-scA1400-30gm: BalanceRatioAbs of a monochrome camera).
        """
        if name not in self._chains:
            chain, node = [name], _target(self._device.get_feature(name))
            while node is not None and node not in chain:
                chain.append(node)
                node = _target(self._device.get_feature(node))
            self._chains[name] = chain
        return self._chains[name]

    def entries(self, name: str) -> tuple[str, ...]:
        """Return the entries that an enumeration offers now; none if the camera has no such enumeration."""
        if self.kind(name) != "choice" or not self.has(name):
            return ()
        offered = self._device.dup_available_enumeration_feature_values_as_strings(name) or ()
        return tuple(dict.fromkeys(offered))

    def read(self, name: str) -> Value:
        """Return the value of a feature; GLib.Error if it cannot be read."""
        kind = self.kind(name) or "string"
        got = getattr(self._device, f"get_{_VALUE[kind]}_feature_value")(name)
        return float(got) if kind == "float" else got

    def write(self, name: str, value: Value) -> None:
        """Write a feature; GLib.Error if the camera refuses it."""
        kind = self.kind(name) or "string"
        value = float(value) if kind == "float" else value
        getattr(self._device, f"set_{_VALUE[kind]}_feature_value")(name, value)

    def limits(self, name: str) -> tuple[float, float, float] | None:
        """Return lowest value, highest value and step (0: none) of a number; None if the feature is no number."""
        kind = self.kind(name)
        if kind not in ("integer", "float"):
            return None
        low, high = getattr(self._device, f"get_{kind}_feature_bounds")(name)
        # A float without a step states the smallest number there is. To Aravis, the step of a number that lies in a
        # masked register is an error (AVT_Mako_G234B: GevSCPSPacketSize); by GenApi it is 1.
        step = 1 if kind == "integer" else 0
        with answered():
            step = self._device.get_integer_feature_increment(name) if kind == "integer" else 0
        return low, high, step

    def unit(self, name: str) -> str:
        """Return the unit of a float as the description states it; an empty text if it states none."""
        node = self._device.get_feature(name)
        return (node.get_unit() or "").strip() if self.kind(name) == "float" else ""

    def text(self, name: str) -> str:
        """Return what the description says of a number in words; an empty text if the camera has no such number."""
        if self.kind(name) not in ("integer", "float"):
            return ""
        node = self._device.get_feature(name)
        return f"{node.get_tooltip() or ''} {node.get_description() or ''}"

    def select(self, at: At) -> None:
        """Let selectors stand at entries."""
        for selector, entry in at:
            if self._selected.get(selector) != entry:
                now = str(self.read(selector))
                self._before.setdefault(selector, now)
                if now != entry:
                    self.write(selector, entry)
                self._selected[selector] = entry

    def forget_selection(self) -> None:
        """Forget where the selectors stand, after something else may have moved them."""
        self._selected.clear()

    def restore_selection(self) -> None:
        """Let all selectors stand as before the first `select`."""
        self.forget_selection()
        self.select(tuple(self._before.items()))

    def execute(self, name: str) -> None:
        """Execute a command and wait until the camera reports its end, at most `COMMAND_S`."""
        self._device.execute_command(name)
        register = _target(self._device.get_feature(name))
        if register is None:
            return
        until_s = time.monotonic() + COMMAND_S
        # A register that cannot be read reports no end.
        with answered():
            while self._device.get_integer_feature_value(register) and time.monotonic() < until_s:
                time.sleep(0.01)


def require_answer(error: Exception) -> None:
    """Raise an error again with which a camera is silent; each access to a camera that has gone takes 2.6 s."""
    if getattr(error, "domain", "") == "arv-device-error-quark" and getattr(error, "code", 0) in _silences():
        raise error


@contextlib.contextmanager
def answered() -> Iterator[None]:
    """Pass over GLib errors in a `with` block with which a camera or its description answers; not over its silence."""
    try:
        yield
    except glib_error() as error:
        require_answer(error)


@functools.cache
def _silences() -> frozenset[int]:
    codes = aravis().DeviceError
    return frozenset({int(codes.TIMEOUT), int(codes.NOT_CONNECTED)})


def _target(node: Any) -> str | None:
    """Return the name of the node that has the value of another one; None if that node has a value itself."""
    child = node.get_first_child() if node is not None else None
    while child is not None:
        if child.get_node_name() == "pValue":
            text = child.get_first_child()
            return text.get_node_value() if text is not None else None
        child = child.get_next_sibling()
    return None

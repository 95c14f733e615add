"""The first values of a camera's registers: what its description demands, and what a camera has after power-on.

A description says where a value lies, not what it is. Here every feature is made present and available, limits are
given that contain sensible values, and each value lies within its limits, for every setting of its selectors.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from vaoi_station.rig.gige.description import REGISTERS, Features
from vaoi_station.rig.gige.formula import Number

_LONGEST = 512
"""Bytes of a register that are given values; the pages of files are longer."""
_BLOCK = 0x0010_0000
_FIRST_BLOCK = 0x6000_0000
"""Where the blocks of registers lie whose addresses the device itself states."""
_NUMBERS = REGISTERS - {"StringReg", "Register"}
BOOTSTRAP_END = 0xA000
"""First address behind the bootstrap registers of GigE Vision."""


@dataclass(frozen=True)
class Sensor:
    """What the description of a camera leaves to its sensor."""

    width_px: int = 1280
    height_px: int = 1024
    exposure_us: float = 10_000.0
    tick_hz: int = 0
    """Ticks of the time stamp per second; 0: what the maker's other cameras have."""


@dataclass(frozen=True)
class _Wish:
    """A value with the limits that should contain it."""

    value: float
    low: float
    high: float
    step: float = 1


_UNIT = _Wish(1, 1, 4)
_WISHES = {
    "BinningHorizontal": _UNIT, "BinningVertical": _UNIT, "DecimationHorizontal": _UNIT, "DecimationVertical": _UNIT,
    "AcquisitionFrameCount": _Wish(1, 1, 1000), "AcquisitionBurstFrameCount": _Wish(1, 1, 1000),
    "TriggerDivider": _Wish(1, 1, 1000), "TriggerMultiplier": _Wish(1, 1, 1000),
    "AcquisitionFrameRate": _Wish(20, 0.1, 200), "AcquisitionFrameRateAbs": _Wish(20, 0.1, 200),
    "AcquisitionFrameRateRaw": _Wish(20, 1, 200), "AcquisitionResultingFrameRate": _Wish(20, 0.1, 200),
    "ResultingFrameRate": _Wish(20, 0.1, 200), "ResultingFrameRateAbs": _Wish(20, 0.1, 200),
    "ExposureTimeBaseAbs": _Wish(1, 1, 1000), "ExposureTimeBaseAbsEnable": _Wish(0, 0, 1),
    "GainAbs": _Wish(0, 0, 24), "Gain": _Wish(0, 0, 24), "Gamma": _Wish(1, 0.25, 4),
    "GainRaw": _Wish(0, 0, 500), "BlackLevel": _Wish(0, 0, 12), "BlackLevelRaw": _Wish(16, 0, 255),
    "TriggerDelay": _Wish(0, 0, 1e6), "TriggerDelayAbs": _Wish(0, 0, 1e6), "TriggerDelayRaw": _Wish(0, 0, 65535),
    "BalanceRatio": _Wish(1, 0.25, 4), "BalanceRatioAbs": _Wish(1, 0.25, 4), "BalanceRatioRaw": _Wish(64, 0, 255),
    "DeviceTemperature": _Wish(41, -40, 100), "TemperatureAbs": _Wish(41, -40, 100),
    "DeviceLinkSpeed": _Wish(125_000_000, 0, 2_000_000_000), "GevLinkSpeed": _Wish(1000, 0, 10_000),
    "DeviceLinkThroughputLimit": _Wish(125_000_000, 1_000_000, 2_000_000_000),
    "DeviceMaxThroughput": _Wish(125_000_000, 0, 2_000_000_000), "StreamBytesPerSecond": _Wish(115e6, 1e6, 124e6),
    "GevSCPSPacketSize": _Wish(1400, 220, 9000, 4), "GevSCPD": _Wish(0, 0, 1e6), "Saturation": _Wish(100, 0, 400),
}  # fmt: skip
"""Feature → what a camera has after power-on, in the camera's units."""
_USUAL = ("Off", "Continuous", "Timed", "Default", "Global", "Standard", "Mono8", "BayerRG8", "BayerGB8")
"""Entries of enumerations that cameras have after power-on, if they have them."""
_FIRST = (
    "DeviceType", "SensorWidth", "SensorHeight", "WidthMax", "HeightMax", "OffsetX", "OffsetY", "Width", "Height",
    "PixelFormat", "ExposureMode", "ExposureAuto", "ExposureTime", "ExposureTimeAbs", "ExposureTimeBaseAbs",
    "ExposureTimeRaw",
)  # fmt: skip
"""Features that are given their values before all others."""


@dataclass
class _Claims:
    """The bits of registers that have their values."""

    bits: dict[int, int] = field(default_factory=dict)

    def places(self, features: Features, register: str) -> Iterator[tuple[int, int]]:
        """Return address and mask of every byte of a register."""
        first, count = features.address(register), min(features.length(register), _LONGEST)
        kind = features.description.kind(register)
        low, bits = features.field(register) if kind in ("IntReg", "MaskedIntReg") else (0, 8 * count)
        order = features.order(register)
        mask = (((1 << bits) - 1) << low).to_bytes(count, order)
        return ((first + k, byte) for k, byte in enumerate(mask) if byte)

    def has(self, features: Features, register: str) -> bool:
        """Whether a register, or a part of it, has its value."""
        return any(self.bits.get(at, 0) & mask for at, mask in self.places(features, register))

    def add(self, features: Features, register: str) -> None:
        """Note that a register has its value."""
        for at, mask in self.places(features, register):
            self.bits[at] = self.bits.get(at, 0) | mask


class FirstValues:
    """Gives all registers of a device their first values."""

    def __init__(self, features: Features, sensor: Sensor) -> None:
        self._features, self._d, self._sensor, self._claims = features, features.description, sensor, _Claims()
        if self._d.is_gige:
            self._claims.bits.update(dict.fromkeys(range(BOOTSTRAP_END), 255))

    def write(self) -> None:
        """Write them."""
        self._blocks()
        names = self._d.features()
        ordered = [n for n in _FIRST if n in self._d.nodes] + [n for n in names if n not in _FIRST]
        for name in ordered:
            for selection in self._features.selections(name):
                with self._features.selecting(selection):
                    self._make_available(name)
                    self._give(name)

    # --- addresses that the device states

    def _blocks(self) -> None:
        """Give an address of its own to each block of registers whose address is read from the device."""
        stated: dict[str, None] = {}
        for name, node in self._d.nodes.items():
            if node.tag in REGISTERS:
                for child in node.iter():
                    if child.tag in ("pAddress", "pVariable"):
                        stated.update(dict.fromkeys(sorted(self._d.closure((child.text or "").strip()))))
        number = itertools.count()
        for name in stated:
            is_address = "addr" in name.casefold() or "offset" in name.casefold()
            if self._d.kind(name) in REGISTERS and self._d.text_of(name, "AccessMode") == "RO" and is_address:
                bits = self._features.field(name)[1]
                block = next(number)
                # Some makers state an address in units of four bytes, from a base of their own.
                self._set(name, _FIRST_BLOCK + block * _BLOCK if bits >= 32 else 0x100 * (block + 1))

    # --- presence

    def _make_available(self, name: str) -> None:
        conditions = [
            condition
            for tag in ("pIsImplemented", "pIsAvailable")
            for node in (name, *self._parts(name))
            for condition in self._features.conditions(node, tag)
        ]
        for entry in self._d.nodes[name].findall("EnumEntry"):
            conditions += [(entry.findtext(tag) or "").strip() for tag in ("pIsImplemented", "pIsAvailable")]
        for condition in conditions:
            if condition in self._d.nodes:
                self._settle(condition, lambda number: number != 0)
        for condition in self._features.conditions(name, "pIsLocked"):
            self._settle(condition, lambda number: number == 0)

    def _parts(self, name: str) -> list[str]:
        return [part for tag in ("pMin", "pMax", "pInc") if (part := self._d.text_of(name, tag)) is not None]

    def _settle(self, name: str, wanted: Callable[[Number], bool], candidates: Iterable[Number] = ()) -> bool:
        """Give registers that a client cannot write such values that a node's value is wanted; return whether it is."""
        if wanted(self._features.value(name)):
            self._claim_read_only(name)
            return True
        free = [r for r in self._read_only(name) if not self._claims.has(self._features, r)]
        before = {register: self._features.value(register) for register in free}
        for register in free:
            self._features.put(register, self._ones(register))
        if wanted(self._features.value(name)):
            self._claim_read_only(name)
            return True
        for register, number in before.items():
            self._features.put(register, number)
        for register in free:
            for candidate in (*candidates, 1, 2, self._ones(register)):
                self._features.put(register, candidate)
                if wanted(self._features.value(name)):
                    self._claim_read_only(name)
                    return True
            self._features.put(register, before[register])
        return False

    def _ones(self, register: str) -> int:
        bits = self._features.field(register)[1] if self._d.kind(register) == "MaskedIntReg" else 32
        return 1 if bits > 1 else 1

    def _read_only(self, name: str) -> list[str]:
        return [
            node
            for node in sorted(self._d.closure(name))
            if self._d.kind(node) in _NUMBERS
            and self._d.text_of(node, "AccessMode") == "RO"
            and self._features.on_device(node)
        ]

    def _claim_read_only(self, name: str) -> None:
        for register in self._read_only(name):
            self._claims.add(self._features, register)

    # --- values

    def _give(self, name: str) -> None:
        kind = self._d.kind(name)
        register = self._d.register_of(name)
        if kind == "String" or self._d.kind(name) == "StringReg":
            self._give_text(name)
        elif kind == "Enumeration":
            self._give_entry(name)
        elif kind not in ("Boolean", "Command", "Register"):
            self._give_number(name)
        if register is not None and self._features.on_device(register):
            self._claims.add(self._features, register)

    def _give_text(self, name: str) -> None:
        register = self._d.register_of(name)
        if register is None or self._claims.has(self._features, register) or not self._features.on_device(register):
            return
        texts = {"DeviceVendorName": self._d.vendor, "DeviceModelName": self._d.model, "DeviceVersion": "1.0"}
        self._features.put(register, texts.get(name, ""))

    def _give_entry(self, name: str) -> None:
        entries = self._d.entries(name)
        register = self._d.register_of(name)
        taken = register is not None and self._claims.has(self._features, register)
        if not entries or (taken and self._features.value(name) in entries.values()):
            return
        usual = next((e for e in _USUAL if e in entries), None)
        if name == "PixelFormat" or usual is not None:
            self._features.put(name, usual or next(iter(entries)))
        if self._features.value(name) not in entries.values():
            self._features.put(name, next(iter(entries)))

    def _wish(self, name: str) -> _Wish | None:
        s = self._sensor
        width, height = _Wish(s.width_px, 16, s.width_px, 4), _Wish(s.height_px, 2, s.height_px, 2)
        exposure = _Wish(s.exposure_us, 20, 1_000_000)
        return {
            "SensorWidth": width, "WidthMax": width, "Width": width,
            "SensorHeight": height, "HeightMax": height, "Height": height,
            "OffsetX": _Wish(0, 0, s.width_px, 4), "OffsetY": _Wish(0, 0, s.height_px, 2),
            "ExposureTime": exposure, "ExposureTimeAbs": exposure, "ExposureTimeRaw": exposure,
            "GevTimestampTickFrequency": _Wish(s.tick_hz, 0, 2e9),
        }.get(name) or _WISHES.get(name)  # fmt: skip

    def _give_number(self, name: str) -> None:
        wish = self._wish(name)
        self._make_computable(name)
        increment, smallest, largest = (self._d.text_of(name, tag) for tag in ("pInc", "pMin", "pMax"))
        if increment is not None:
            step = wish.step if wish else 1
            self._reach(increment, step, lambda number: number > 0)
        if smallest is not None and wish is not None:
            low = wish.low
            self._reach(smallest, low, lambda number: number <= wish.value and number > -1e30)
        if largest is not None:
            low = self._features.value(smallest) if smallest is not None else 0
            high = wish.high if wish else 1000.0
            value = wish.value if wish else low + 1
            self._reach(largest, high, lambda number: number >= max(value, low + 1) and number < 1e30, always=True)
        register = self._d.register_of(name)
        if register is None:
            if wish is not None and not math.isclose(self._features.value(name), wish.value):
                self._reach(name, wish.value, lambda number: math.isclose(number, wish.value))
            return
        if not self._features.on_device(register) or self._claims.has(self._features, register):
            return
        low_end, high_end, _ = self._features.limits(name)
        now = self._features.value(name)
        value = wish.value if wish else now
        if low_end < high_end:
            value = max(min(value, high_end), low_end)
        if value != now:
            self._features.put(name, value)

    def _make_computable(self, name: str) -> None:
        """Give registers that are divisors, and are 0, a value."""
        parts = (name, *self._parts(name))
        if not self._fails(parts):
            return
        for register in sorted({r for part in parts for r in self._d.closure(part) if self._d.kind(r) in _NUMBERS}):
            if self._features.value(register) == 0 and not self._claims.has(self._features, register):
                self._features.put(register, 1_000_000 if "timebase" in register.casefold() else 1)
                self._claims.add(self._features, register)

    def _fails(self, names: Iterable[str]) -> bool:
        before = self._features.failures
        self._features.forget()
        for name in names:
            self._features.value(name)
        return self._features.failures > before

    def _reach(self, name: str, target: float, enough: Callable[[Number], bool], *, always: bool = False) -> None:
        """Give the registers behind a node, a limit, such values that it is near a target, if it is not there yet."""
        claimed = all(self._claims.has(self._features, r) for r in self._read_only(name))
        now = self._features.value(name)
        if (enough(now) and (claimed or not always)) or not self._d.closure(name):
            self._claim_read_only(name)
            return
        register = self._d.register_of(name)
        if register is not None:
            if self._features.on_device(register) and not self._claims.has(self._features, register):
                self._features.put(name, target)
                self._claims.add(self._features, register)
            return
        for leaf in self._read_only(name):
            if self._claims.has(self._features, leaf):
                continue
            before = self._features.value(leaf)
            for raw in self._guesses(name, leaf, target):
                self._features.put(leaf, raw)
                if enough(self._features.value(name)):
                    self._claim_read_only(name)
                    return
            self._features.put(leaf, before)

    def _guesses(self, name: str, leaf: str, target: float) -> Iterator[Number]:
        """Yield values of a register for which a formula of it may be near the target: straight lines first."""
        ends = []
        for raw in (1, 2):
            self._features.put(leaf, raw)
            ends.append(self._features.value(name))
        slope = ends[1] - ends[0]
        low, high, _ = self._features.limits(leaf)
        if slope:
            yield max(min(1 + (target - ends[0]) / slope, high), low)
        if ends[0] and target:
            yield max(min(ends[0] / target, high), low)
        yield max(min(target, high), low)
        yield high

    def _set(self, register: str, value: Number) -> None:
        self._features.put(register, value)
        self._claims.add(self._features, register)

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
_SCALES = {"numerator": 1_000_000, "timebase": 1000}
"""Part of a register's name → its value if it is a divisor or a factor."""
_USUAL = ("Off", "Continuous", "Timed", "Default", "Global", "Standard", "Mono8", "BayerRG8", "BayerGB8")
"""Entries of enumerations that cameras have after power-on, if they have them."""
_FIRST = (
    "DeviceType", "SensorWidth", "SensorHeight", "WidthMax", "HeightMax", "OffsetX", "OffsetY", "Width", "Height",
    "PixelFormat", "ExposureMode", "ExposureAuto", "ExposureTimeBaseAbs", "ExposureTime", "ExposureTimeAbs",
    "ExposureTimeRaw",
)  # fmt: skip
"""Features that are given their values before all others."""


@dataclass
class _Claims:
    """The bits of the memory that have their values."""

    bits: dict[int, int] = field(default_factory=dict)
    """Address of a byte → mask."""

    def add(self, features: Features, register: str, mask: int = -1) -> None:
        """Note that a register, or the bits of its value in `mask`, have their values."""
        for number, at, bit in self._places(features, register):
            if mask & number:
                self.bits[at] = self.bits.get(at, 0) | bit

    def free(self, features: Features, register: str) -> int:
        """Return the bits of a register's value that have none yet."""
        return sum(n for n, at, bit in self._places(features, register) if not self.bits.get(at, 0) & bit)

    def has(self, features: Features, register: str) -> bool:
        """Whether a part of a register has its value."""
        return any(self.bits.get(at, 0) & bit for _, at, bit in self._places(features, register))

    @staticmethod
    def _places(features: Features, register: str) -> Iterator[tuple[int, int, int]]:
        """Yield every bit of a register's value with the byte and the bit of the memory that hold it."""
        first, count = features.address(register), min(features.length(register), _LONGEST)
        kind = features.description.kind(register)
        low, bits = features.field(register) if kind in ("IntReg", "MaskedIntReg") else (0, 8 * count)
        big = features.order(register) == "big"
        for k in range(bits):
            byte, bit = divmod(low + k, 8)
            yield 1 << k, first + (count - 1 - byte if big else byte), 1 << bit


class FirstValues:
    """Gives all registers of a device their first values, but for the bytes of its bootstrap registers."""

    def __init__(self, features: Features, sensor: Sensor, bootstrap: Iterable[int] = ()) -> None:
        self._features, self._d, self._sensor, self._claims = features, features.description, sensor, _Claims()
        self._claims.bits.update(dict.fromkeys(bootstrap, 255))

    def write(self) -> None:
        """Write them."""
        self._blocks()
        names = self._d.features()
        ordered = [n for n in _FIRST if n in self._d.nodes]
        ordered += [n for n in names if n in _WISHES and n not in ordered]
        ordered += [n for n in names if n not in ordered]
        for name in ordered:
            if _is_rolling(name, self._d.entries(name)):
                continue  # a camera without it, as one with it is refused
            for selection in self._features.selections(name):
                with self._features.selecting(selection):
                    self._make_available(name)
                    self._give(name)

    # --- addresses that the device states

    def _blocks(self) -> None:
        """Give an address of its own to each block of registers whose address is read from the device."""
        stated: dict[str, None] = {}
        for node in self._d.nodes.values():
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

    def _settle(self, name: str, wanted: Callable[[Number], bool]) -> bool:
        """Set bits that a client cannot write, such that a node's value is wanted; return whether it is."""
        if wanted(self._features.value(name)):
            for register in self._stated(name):
                if self._d.kind(register) == "MaskedIntReg" and self._decides(register, name, wanted):
                    self._claims.add(self._features, register)
            return True
        free = {register: self._claims.free(self._features, register) for register in self._stated(name)}
        before = {register: int(self._features.value(register)) for register in free}
        for register, bits in free.items():
            for bit in _bits_of(bits):
                self._features.put(register, before[register] | bit)
                if wanted(self._features.value(name)):
                    self._claims.add(self._features, register, bit)
                    return True
            self._features.put(register, before[register])
        for register, bits in free.items():  # several conditions at once
            self._features.put(register, before[register] | bits)
        if wanted(self._features.value(name)):
            for register, bits in free.items():
                self._claims.add(self._features, register, bits)
            return True
        for register, number in before.items():
            self._features.put(register, number)
        return False

    def _decides(self, register: str, name: str, wanted: Callable[[Number], bool]) -> bool:
        """Whether a register has a value, or must have none for a node's value to be wanted."""
        if self._features.value(register):
            return True
        self._features.put(register, 1)
        harmless = wanted(self._features.value(name))
        self._features.put(register, 0)
        return not harmless

    def _stated(self, name: str) -> list[str]:
        """Return the integer registers behind a node's value that a client cannot write."""
        return [
            r for r in self._features.read_by(name)
            if self._d.kind(r) in ("IntReg", "MaskedIntReg")
            and self._d.text_of(r, "AccessMode") == "RO"
            and self._features.on_device(r)
        ]  # fmt: skip

    # --- values

    def _give(self, name: str) -> None:
        kind = self._d.kind(name)
        register = self._features.register_of(name)
        if kind == "String" or self._d.kind(name) == "StringReg":
            self._give_text(name)
        elif kind == "Enumeration":
            self._give_entry(name)
        elif kind not in ("Boolean", "Command", "Register"):
            self._give_number(name)
        # A converter of integers writes some bits of a word, and leaves the others.
        if register is not None and self._features.on_device(register) and not self._is_converted(name):
            self._claims.add(self._features, register)

    def _is_converted(self, name: str) -> bool:
        while (inner := self._d.text_of(name, "pValue")) is not None and inner in self._d.nodes:
            if self._d.kind(name) == "IntConverter":
                return True
            name = inner
        return False

    def _give_text(self, name: str) -> None:
        register = self._features.register_of(name)
        if register is None or self._claims.has(self._features, register) or not self._features.on_device(register):
            return
        texts = {"DeviceVendorName": self._d.vendor, "DeviceModelName": self._d.model, "DeviceVersion": "1.0"}
        self._features.put(register, texts.get(name, ""))

    def _give_entry(self, name: str) -> None:
        entries = self._d.entries(name)
        register = self._features.register_of(name)
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
        self._give_limits(name, wish)
        register = self._features.register_of(name)
        if register is None:
            if wish is not None:
                value = wish.value
                self._reach(name, value, lambda number: math.isclose(number, value))
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

    def _give_limits(self, name: str, wish: _Wish | None) -> None:
        """Let the limits of a node, and of the nodes that keep its value, contain what is wished."""
        if name not in self._d.nodes:
            return
        value_of = self._d.text_of(name, "pValue")  # Mako_U-029B: SensorWidth is its own limit
        increment, smallest, largest = (
            None if limit == value_of else limit
            for limit in (self._d.text_of(name, tag) for tag in ("pInc", "pMin", "pMax"))
        )
        if increment is not None:
            self._reach(increment, wish.step if wish else 1, lambda number: number > 0, always=wish is not None)
        if smallest is not None and wish is not None:
            most = wish.value
            self._reach(smallest, wish.low, lambda number: -1e30 < number <= most, always=True)
        if largest is not None:
            low = self._features.value(smallest) if smallest is not None else 0
            least = wish.value if wish else low + 1
            self._reach(largest, wish.high if wish else 1000.0, lambda number: least <= number < 1e30, always=True)
        if value_of is None:
            return
        if wish is not None and self._d.kind(name) in ("Converter", "IntConverter"):
            value, *ends = (self._features.converted(name, x) for x in (wish.value, wish.low, wish.high))
            wish = _Wish(value, min(ends), max(ends))
        self._give_limits(value_of, wish)

    def _make_computable(self, name: str) -> None:
        """Give registers that are divisors, and are 0, a value."""
        parts = (name, *self._parts(name))
        if not self._fails(parts):
            return
        for register in sorted({r for part in parts for r in self._d.closure(part) if self._d.kind(r) in _NUMBERS}):
            if self._features.value(register) == 0 and not self._claims.has(self._features, register):
                # A rate is a numerator, in units per second, by a count; a time base is in ns.
                is_stated = self._d.text_of(register, "AccessMode") == "RO"
                scale = next((n for word, n in _SCALES.items() if is_stated and word in register.casefold()), 1)
                self._features.put(register, scale)
                if scale > 1:
                    self._claims.add(self._features, register)

    def _fails(self, names: Iterable[str]) -> bool:
        before = self._features.failures
        self._features.forget()
        for name in names:
            self._features.value(name)
            for node in self._d.closure(name):
                if self._d.kind(node) in ("Converter", "IntConverter"):
                    self._features.converted(node, 1)
        return self._features.failures > before

    def _reach(self, name: str, target: float, enough: Callable[[Number], bool], *, always: bool = False) -> None:
        """Give the registers behind a node, a limit, such values that it is near a target, if it is not there yet.

        With `always` a limit that is good enough comes nearer too, if a register of it has no value yet.
        """
        registers = [
            r for r in self._features.read_by(name) if self._d.kind(r) in _NUMBERS and self._features.on_device(r)
        ]
        registers.sort(key=lambda r: self._d.text_of(r, "AccessMode") != "RO")
        now = self._features.value(name)
        is_free = any(self._claims.free(self._features, r) for r in registers)
        if enough(now) and not (always and is_free):
            return
        own = self._features.register_of(name)
        if own is not None and not self._claims.has(self._features, own):
            self._features.put(name, target)
            self._claims.add(self._features, own)
            return
        for register in registers:
            before = self._features.value(register)
            for raw in self._guesses(name, register, target):
                self._features.put(register, raw)
                failures = self._features.failures
                if enough(self._features.value(name)) and self._features.failures == failures:
                    self._claims.add(self._features, register, self._weighty)
                    return
                self._features.put(register, before)

    def _guesses(self, name: str, register: str, target: float) -> Iterator[Number]:
        """Yield values of a register for which a formula of it may be near the target."""
        before = self._features.value(register)

        def at(raw: Number) -> Number:
            self._features.put(register, raw)
            number = self._features.value(name)
            self._features.put(register, before)
            return number

        low, high, _ = self._features.limits(register)
        free = self._claims.free(self._features, register)
        is_whole = free == self._all_bits(register)
        if is_whole and not self._takes_bits(name):
            self._weighty = free
            yield max(min(target, high), low)
        if self._d.kind(register) != "FloatReg":
            # Fields inside of a word: each bit adds its own weight.
            raw = int(before) & ~free
            base = at(raw)
            weights = sorted(((at(raw | bit) - base, bit) for bit in _bits_of(free)), reverse=True)
            self._weighty = sum(bit for weight, bit in weights if weight)
            for weight, bit in weights:
                if 0 < weight <= target - base:
                    raw, base = raw | bit, base + weight
            yield raw
        if not is_whole:
            return
        self._weighty = free
        ends = at(1), at(2)
        if slope := ends[1] - ends[0]:
            yield max(min(1 + (target - ends[0]) / slope, high), low)
        if ends[0] and target:
            yield max(min(ends[0] / target, high), low)
        yield max(min(target, high), low)

    def _takes_bits(self, name: str) -> bool:
        """Whether a formula behind a node takes single bits of a word."""
        return any("&" in (self._d.text_of(n, "Formula", "FormulaFrom") or "") for n in self._d.closure(name))

    def _all_bits(self, register: str) -> int:
        size = 8 * min(self._features.length(register), _LONGEST)
        bits = self._features.field(register)[1] if self._d.kind(register) != "FloatReg" else size
        return (1 << bits) - 1

    def _set(self, register: str, value: Number) -> None:
        self._features.put(register, value)
        self._claims.add(self._features, register)


def _is_rolling(name: str, entries: Iterable[str]) -> bool:
    """Whether a feature is a shutter that offers no global one."""
    return "Shutter" in name and "Rolling" in entries and not {"Global", "GlobalShutter"} & set(entries)


def _bits_of(mask: int) -> Iterator[int]:
    """Yield the single bits of a mask, the highest first."""
    for k in reversed(range(mask.bit_length())):
        if mask >> k & 1:
            yield 1 << k

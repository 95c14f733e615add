"""A GenICam description (GenApi 1.0 and 1.1): its nodes, and the values of features over the registers of a device.

Values of enumerations and Booleans are their integers. A selector that lives in the client has an integer of its own
here; `selecting` gives it another one for a while, as a client does before it reads what the selector selects.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Literal, Protocol
from xml.etree import ElementTree as ET

from vaoi_station.rig.gige.formula import Number, number_of, parse

REGISTERS = frozenset({"IntReg", "MaskedIntReg", "FloatReg", "StringReg", "Register"})
FEATURES = frozenset({"Integer", "Float", "Boolean", "Enumeration", "Command", "String"})
_FORMULAS = frozenset({"SwissKnife", "IntSwissKnife"})
_CONVERTERS = frozenset({"Converter", "IntConverter"})
_REFERENCES = frozenset({"pValue", "pAddress", "pIndex", "pVariable", "pLength", "pValueIndexed", "pValueDefault"})
_MOST_COMBINATIONS = 64
"""Of the values of several selectors."""


class DescriptionError(ValueError):
    """A description, or a node of it, that cannot be read."""


class Memory(Protocol):
    """The registers of a device."""

    def read(self, address: int, count: int) -> bytes:
        """Return bytes."""

    def write(self, address: int, content: bytes) -> None:
        """Change bytes."""


def root_of(text: str) -> ET.Element:
    """Return the root of a description, without name spaces; text before the XML is passed over."""
    start = text.find("<RegisterDescription")
    if start < 0:
        raise DescriptionError("the description has no element RegisterDescription.")
    try:
        root = ET.fromstring(text[start:])
    except ET.ParseError as error:
        raise DescriptionError(f"the description cannot be parsed: {error}.") from error
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


class Description:
    """The nodes of a description by name, and which selectors select them."""

    def __init__(self, text: str) -> None:
        # Files that Aravis' tool has written begin with a line that names the camera.
        starts = [at for at in (text.find("<?xml"), text.find("<RegisterDescription")) if at >= 0]
        self.text = text[min(starts, default=0) :]
        root = root_of(self.text)
        self._root = root
        self.vendor, self.model = root.get("VendorName", "Test"), root.get("ModelName", "Test")
        self.nodes: dict[str, ET.Element] = {}
        for element in root.iter():
            if element.tag == "StructReg":
                self._add_entries(element)
            elif element.tag in REGISTERS | FEATURES | _FORMULAS | _CONVERTERS | {"Category", "Port"}:
                self.nodes.setdefault(element.get("Name", ""), element)
        self.nodes.pop("", None)  # formulas inside of registers
        self.selectors: dict[str, list[str]] = {}
        # PGR_Flea3 has LineMode below TriggerMode as well, which locks it and selects nothing.
        for name, node in ((n, node) for n, node in self.nodes.items() if n.endswith("Selector")):
            for selected in _texts(node, "pSelected"):
                self.selectors.setdefault(selected, []).append(name)
        self._closures: dict[str, frozenset[str]] = {}

    @property
    def is_gige(self) -> bool:
        """Whether it describes a GigE camera: others have their own bootstrap registers at the same addresses."""
        # MV-CA013-A0UM: a USB3 camera that has some names of GigE Vision.
        return self._root.get("StandardNameSpace") != "USB" and any(name.startswith("Gev") for name in self.nodes)

    def kind(self, name: str) -> str:
        """Return the tag of a node; empty if there is none."""
        node = self.nodes.get(name)
        return "" if node is None else node.tag

    def text_of(self, name: str, *tags: str) -> str | None:
        """Return the text of the first of these children that a node has."""
        for tag in tags:
            if (text := self.nodes[name].findtext(tag)) is not None:
                return text.strip()
        return None

    def entries(self, name: str) -> dict[str, int]:
        """Return the entries of an enumeration."""
        return {e.get("Name", ""): int(_number(e, "Value")) for e in self.nodes[name].findall("EnumEntry")}

    def features(self) -> list[str]:
        """Return all features that a client can reach from the category Root, in order."""
        found: dict[str, None] = {}
        pending = ["Root"]
        while pending:
            name = pending.pop()
            for child in _texts(self.nodes[name], "pFeature") if name in self.nodes else []:
                if self.kind(child) == "Category" and child not in found:
                    pending.append(child)
                if child in self.nodes:
                    found[child] = None
        return [name for name in found if self.kind(name) != "Category"]

    def closure(self, name: str) -> frozenset[str]:
        """Return the nodes on which the value of a node depends, with itself."""
        if name not in self._closures:
            found, pending = set(), [name]
            while pending:
                at = pending.pop()
                if at in found or at not in self.nodes:
                    continue
                found.add(at)
                pending += [(e.text or "").strip() for e in self.nodes[at].iter() if e.tag in _REFERENCES]
            self._closures[name] = frozenset(found)
        return self._closures[name]

    def all_selectors(self, name: str) -> list[str]:
        """Return the selectors of a feature, with those of its selectors."""
        found: list[str] = []
        for selector in self.selectors.get(name, ()):
            if selector not in found and selector != name:
                found += [s for s in (*self.all_selectors(selector), selector) if s not in found]
        return found

    def _add_entries(self, parent: ET.Element) -> None:
        shared = [child for child in parent if child.tag != "StructEntry"]
        for entry in parent.findall("StructEntry"):
            node = ET.Element("MaskedIntReg", entry.attrib)
            node.extend([*entry, *shared])  # what the entry says comes first
            self.nodes.setdefault(entry.get("Name", ""), node)


class Features:
    """The values of a description's nodes over registers."""

    def __init__(self, description: Description, memory: Memory) -> None:
        self.description, self.memory = description, memory
        self._client: dict[str, Number] = {}
        """Values that live in the client."""
        self.banked: dict[str, tuple[str, ...]] = {}
        """Register → the selectors by which the device itself exchanges its content."""
        self.banks: dict[tuple[str, tuple[Number, ...]], bytes] = {}
        self._memo: dict[str, Number] = {}
        """Values since the last write: the formulas of some makers are as deep as they are wide."""
        self._read: set[str] = set()
        self.failures = 0
        """Formulas that could not be evaluated with the values of their variables, and gave 0."""
        self._find_banks()

    def forget(self) -> None:
        """Read all registers again, as somebody else has written to them."""
        self._memo.clear()

    def __contains__(self, name: str) -> bool:
        return name in self.description.nodes

    @contextlib.contextmanager
    def selecting(self, selection: Mapping[str, Number | str]) -> Iterator[None]:
        """Read and write what these selectors select; a value is an integer or the name of an entry."""
        before = {name: self.value(name) for name in selection}
        try:
            for name, value in selection.items():
                self.put(name, value)
            yield
        finally:
            for name, number in before.items():
                self.put(name, number)

    def selections(self, name: str, *, hidden: bool = False) -> Iterator[dict[str, Number]]:
        """Return all settings of the selectors of a feature; one empty setting if it has none.

        With `hidden` the other values that the client keeps, and by which it finds the register, are selectors too.
        """
        d = self.description
        selectors = [s for s in d.all_selectors(name) if d.kind(s) in FEATURES]
        if hidden:
            known = {part for s in selectors for part in d.closure(s)}
            selectors += [n for n in sorted(d.closure(name)) if n not in known and self._is_in_client(n)]
        ranges: list[list[Number]] = []
        for selector in selectors:
            if d.kind(selector) == "Enumeration":
                ranges.append(list(d.entries(selector).values()))
            else:
                low, high, _ = self.limits(selector)
                ranges.append(list(range(int(low), int(min(high, low + 15)) + 1)))
        for values in itertools.islice(itertools.product(*ranges), _MOST_COMBINATIONS):
            yield dict(zip(selectors, values, strict=True))

    def _is_in_client(self, name: str) -> bool:
        node = self.description.nodes[name]
        return node.tag == "Integer" and node.find("Value") is not None and node.find("Max") is not None

    def value(self, name: str) -> Number:
        """Return the value of a node: a number."""
        if name not in self._memo:
            self._memo[name] = self._value(name)
        return self._memo[name]

    def read_by(self, name: str) -> list[str]:
        """Return the registers that are read for the value of a node now, in the order of their names."""
        self._memo.clear()
        self._read.clear()
        self.value(name)
        return sorted(self._read)

    def converted(self, name: str, value: Number) -> Number:
        """Return what a converter writes for a value."""
        return self._formula(self.description.nodes[name], "FormulaTo", {"FROM": value})

    def _value(self, name: str) -> Number:
        node = self.description.nodes[name]
        if node.tag in REGISTERS:
            self._read.add(name)
            return self._decode(name, self._bytes(name))
        if node.tag in _FORMULAS:
            return self._formula(node, "Formula", {})
        if node.tag in _CONVERTERS:
            return self._formula(node, "FormulaFrom", {"TO": self.value(_text(node, "pValue"))})
        if (inner := self._inner(node)) is not None:
            raw = self.value(inner)
            return int(raw == _number(node, "OnValue", 1)) if node.tag == "Boolean" else raw
        if (index := node.find("pIndex")) is not None:
            node, tag = self._indexed(node, int(self.value((index.text or "").strip()))), "."
        else:
            tag = "Value"
        return self._client[name] if name in self._client else _number(node, tag, 0)

    def text(self, name: str) -> str:
        """Return the value of a string, or the name of an enumeration's entry."""
        if self.description.kind(name) == "Enumeration":
            number = self.value(name)
            return next((e for e, v in self.description.entries(name).items() if v == number), str(number))
        register = self.register_of(name)
        return "" if register is None else self._bytes(register).split(b"\0")[0].decode("utf-8", "replace")

    def put(self, name: str, value: Number | str) -> None:
        """Write a node as a client does, whatever its access mode and its limits are."""
        self._memo.clear()
        node = self.description.nodes[name]
        if node.tag in REGISTERS:
            self._write(name, value)
            return
        if isinstance(value, str) and node.tag == "Enumeration":
            value = self.description.entries(name)[value]
        inner = self._inner(node)
        if node.tag in _CONVERTERS and isinstance(value, int | float):
            value = self._formula(node, "FormulaTo", {"FROM": value})
            if node.tag == "IntConverter":
                value = int(value)
        elif node.tag == "Boolean":
            value = _number(node, "OnValue" if value else "OffValue", int(bool(value)))
        if inner is None:
            if node.tag in FEATURES and isinstance(value, int | float):
                self._client[name] = value
            return
        self.put(inner, value)

    def limits(self, name: str) -> tuple[Number, Number, Number]:
        """Return smallest value, largest value and step of a node."""
        return self._bound(name, "Min"), self._bound(name, "Max"), self._bound(name, "Inc")

    def allows(self, name: str, tag: str) -> bool:
        """Return whether a condition of a node, or of the nodes that keep its value, holds: `pIsImplemented` …"""
        return all(self.value(condition) for condition in self.conditions(name, tag))

    def allows_entry(self, name: str, entry: str) -> bool:
        """Whether an enumeration has an entry now."""
        node = next(e for e in self.description.nodes[name].findall("EnumEntry") if e.get("Name") == entry)
        conditions = [(node.findtext(tag) or "").strip() for tag in ("pIsImplemented", "pIsAvailable")]
        return all(self.value(c) for c in conditions if c in self.description.nodes)

    def conditions(self, name: str, tag: str) -> list[str]:
        """Return the nodes of a condition of a feature and of the nodes that keep its value."""
        found = []
        following: str | None = name
        while following is not None and following in self.description.nodes:
            node = self.description.nodes[following]
            condition = node.findtext(tag)
            if condition is not None and condition.strip() in self.description.nodes:
                found.append(condition.strip())
            following = self._inner(node)
        return found

    # --- registers

    def register_of(self, name: str) -> str | None:
        """Return the register in which a node keeps its value; None if the client keeps it, or a formula gives it."""
        following: str | None = name
        while following in self.description.nodes and self.description.kind(following) not in REGISTERS:
            following = self._inner(self.description.nodes[following])
        return following if following in self.description.nodes else None

    def address(self, register: str) -> int:
        """Return the address of a register: the sum of all that its node names."""
        node, total = self.description.nodes[register], 0
        for child in node:
            if child.tag == "Address":
                total += int(number_of(child.text or "0"))
            elif child.tag == "pAddress":
                total += int(self.value((child.text or "").strip()))
            elif child.tag == "IntSwissKnife":
                total += int(self._formula(child, "Formula", {}))
            elif child.tag == "pIndex":
                if (offset_name := child.get("pOffset")) is not None:
                    offset = int(self.value(offset_name))
                else:
                    offset = int(number_of(child.get("Offset", str(self.length(register)))))
                total += int(self.value((child.text or "").strip())) * offset
        return total & 0xFFFFFFFF

    def length(self, register: str) -> int:
        """Return the bytes of a register."""
        node = self.description.nodes[register]
        by_node = node.findtext("pLength")
        return int(_number(node, "Length", 4) if by_node is None else self.value(by_node.strip()))

    def field(self, register: str) -> tuple[int, int]:
        """Return lowest bit and number of bits of an integer register, counted from its least significant bit."""
        node, bits = self.description.nodes[register], 8 * self.length(register)
        if node.tag != "MaskedIntReg":
            return 0, bits
        if (bit := node.find("Bit")) is not None:
            low = high = int(number_of(bit.text or "0"))
        else:
            low, high = sorted((int(_number(node, "LSB")), int(_number(node, "MSB"))))
        if self._order(node) == "big":  # bit 0 is the most significant one
            low, high = bits - 1 - high, bits - 1 - low
        return low, high - low + 1

    def on_device(self, register: str) -> bool:
        """Whether a register is one of the device, not of chunk data or of an event."""
        port = self.description.nodes.get((self.description.nodes[register].findtext("pPort") or "").strip())
        return port is None or (port.find("ChunkID") is None and port.find("EventID") is None)

    def exchange(self, selector_registers: frozenset[str], before: Mapping[str, Number]) -> None:
        """Exchange the contents of registers after a client has changed selectors in the device."""
        for register, selectors in self.banked.items():
            if not selector_registers.intersection(map(str, map(self.register_of, selectors))):
                continue
            old = tuple(before[s] for s in selectors)
            new = tuple(self.value(s) for s in selectors)
            if old != new:
                self.banks[register, old] = self._raw(register)
                self._put_raw(register, self.banks.get((register, new), self.banks[register, old]))

    def selector_values(self) -> dict[str, Number]:
        """Return the values of all selectors in the device."""
        return {s: self.value(s) for selectors in self.banked.values() for s in selectors}

    def _raw(self, register: str) -> bytes:
        return self.memory.read(self.address(register), self.length(register))

    def _put_raw(self, register: str, content: bytes) -> None:
        # Only the bits of this register: its neighbours at the same address may belong to other selectors.
        if self.description.kind(register) == "MaskedIntReg":
            self._write(register, self._decode(register, content))
        else:
            self.memory.write(self.address(register), content)
            self._memo.clear()

    def _bytes(self, register: str) -> bytes:
        if not self.on_device(register):
            return bytes(self.length(register))
        return self._raw(register)

    def order(self, register: str) -> Literal["little", "big"]:
        """Return the order of a register's bytes."""
        return self._order(self.description.nodes[register])

    def _order(self, node: ET.Element) -> Literal["little", "big"]:
        return "little" if (node.findtext("Endianess") or "").strip() == "LittleEndian" else "big"

    def _decode(self, register: str, content: bytes) -> Number:
        node = self.description.nodes[register]
        order = self._order(node)
        if node.tag == "FloatReg":
            kind = "d" if len(content) == 8 else "f"
            return float(struct.unpack(("<" if order == "little" else ">") + kind, content)[0])
        low, bits = self.field(register)
        number = int.from_bytes(content, order) >> low & ((1 << bits) - 1)
        signed = (node.findtext("Sign") or "").strip() == "Signed"
        return number - (1 << bits) if signed and number >> (bits - 1) else number

    def _write(self, register: str, value: Number | str) -> None:
        if not self.on_device(register):
            return
        before = self.selector_values() if self._selects(register) else {}
        node, count, address = self.description.nodes[register], self.length(register), self.address(register)
        order = self._order(node)
        if isinstance(value, str):
            content = value.encode()[:count].ljust(count, b"\0")
        elif node.tag == "FloatReg":
            kind = "d" if count == 8 else "f"
            content = struct.pack(("<" if order == "little" else ">") + kind, float(value))
        else:
            low, bits = self.field(register)
            mask = ((1 << bits) - 1) << low
            there = int.from_bytes(self.memory.read(address, count), order)
            lowest, highest = self._register_bound(register, "Min"), self._register_bound(register, "Max")
            number = there & ~mask | (round(max(min(value, highest), lowest)) << low) & mask
            content = number.to_bytes(count, order)
        self.memory.write(address, content)
        self._memo.clear()
        if before:
            self.exchange(frozenset({register}), before)

    def _selects(self, register: str) -> bool:
        return any(self.register_of(s) == register for selectors in self.banked.values() for s in selectors)

    def _find_banks(self) -> None:
        """Find the registers that lie at one address for all values of a selector that the device keeps."""
        d = self.description
        for feature, selectors in d.selectors.items():
            register = self.register_of(feature) if feature in d.nodes else None
            if register is None or d.kind(feature) == "Command" or not self.on_device(register):
                continue
            for selector in selectors:
                at = self.register_of(selector)
                # A selector that is made of another value, as the trigger mode of IIDC, exchanges nothing.
                if any(d.kind(node) in _CONVERTERS for node in d.closure(selector)):
                    continue
                # A client computes the address or chooses the register by the selector's value.
                if at is None or at == register or at in d.closure(feature) or selector in d.closure(feature):
                    continue
                if selector not in self.banked.get(register, ()):
                    self.banked[register] = (*self.banked.get(register, ()), selector)

    # --- nodes

    def _inner(self, node: ET.Element) -> str | None:
        """Return the node that keeps the value of a node now; None if there is none."""
        if (inner := node.findtext("pValue")) is not None:
            return inner.strip()
        if (index := node.find("pIndex")) is not None and node.tag in FEATURES:
            chosen = self._indexed(node, int(self.value((index.text or "").strip())))
            return (chosen.text or "").strip() if chosen.tag.startswith("p") else None
        return None

    def _indexed(self, node: ET.Element, index: int) -> ET.Element:
        for child in node:
            if child.tag in ("ValueIndexed", "pValueIndexed") and number_of(child.get("Index", "0")) == index:
                return child
        for child in node:
            if child.tag in ("ValueDefault", "pValueDefault"):
                return child
        raise DescriptionError(f"{node.get('Name')}: has no value with index {index}.")

    def _formula(self, node: ET.Element, tag: str, known: dict[str, Number]) -> Number:
        constants = {c.get("Name", ""): number_of(c.text or "0") for c in node.findall("Constant")}
        nodes = {v.get("Name", ""): (v.text or "").strip() for v in node.findall("pVariable")}
        expressions = {e.get("Name", ""): (e.text or "").strip() for e in node.findall("Expression")}

        def variable(name: str) -> Number:
            if name in known:
                return known[name]
            if name in constants:
                return constants[name]
            if name in expressions:
                return parse(expressions[name], real=real)(variable)
            known[name] = kind(self._variable(name, nodes))
            return known[name]

        real = not node.tag.startswith("Int")
        kind = float if real else int
        try:
            result = parse(_text(node, tag), real=real)(variable)
        except (ZeroDivisionError, OverflowError, ValueError):
            self.failures += 1
            return 0
        return int(result) if not real else float(result)

    def _variable(self, name: str, nodes: Mapping[str, str]) -> Number:
        if name in nodes:
            return self.value(nodes[name])
        base, _, suffix = name.partition(".")
        which = nodes[base]
        if suffix in ("Min", "Max", "Inc"):
            return self._bound(which, suffix)
        if suffix.startswith(("Enum.", "Entry.")):
            return self.description.entries(which)[suffix.partition(".")[2]]
        return self.value(which)

    def _bound(self, name: str, which: str) -> Number:
        node = self.description.nodes[name]
        by_node, text, inner = node.findtext(f"p{which}"), node.findtext(which), self._inner(node)
        if by_node is not None and by_node.strip() in self.description.nodes:
            bound = self.value(by_node.strip())
        elif text is not None:
            bound = number_of(text)
        elif node.tag in REGISTERS:
            bound = self._register_bound(name, which)
        elif inner is None or inner not in self.description.nodes:
            bound = {"Min": 0, "Max": (1 << 31) - 1, "Inc": 1}[which]
        elif node.tag not in _CONVERTERS:
            bound = self._bound(inner, which)
        else:
            bound = 1 if which == "Inc" else self._converted_bound(node, inner, which)
        return bound

    def _converted_bound(self, node: ET.Element, inner: str, which: str) -> Number:
        ends = []
        for end in ("Min", "Max"):
            failures = self.failures
            number = self._formula(node, "FormulaFrom", {"TO": self._bound(inner, end)})
            ends.append(number if self.failures == failures else math.inf)
        return min(ends) if which == "Min" else max(ends)

    def _register_bound(self, register: str, which: str) -> Number:
        if which == "Inc":
            return 1
        if self.description.kind(register) == "FloatReg":
            return -3.4e38 if which == "Min" else 3.4e38
        bits = self.field(register)[1]
        if (self.description.nodes[register].findtext("Sign") or "").strip() == "Signed":
            return -(1 << (bits - 1)) if which == "Min" else (1 << (bits - 1)) - 1
        return 0 if which == "Min" else (1 << bits) - 1


_REGISTER = re.compile(rf"<({'|'.join((*sorted(REGISTERS), 'StructReg'))})\b.*?</\1>", re.DOTALL)
_PORT = re.compile(r'<Port\b[^>]*Name="([^"]+)"(?:[^>]*/>|.*?</Port>)', re.DOTALL)


def moved(text: str, shift: int) -> str:
    """Return a description whose registers lie `shift` bytes higher, and whose addresses have 32 bits."""
    foreign = {port[1] for port in _PORT.finditer(text) if "ChunkID" in port[0] or "EventID" in port[0]}

    def with_shift(register: re.Match[str]) -> str:
        port = re.search(r"<pPort>\s*(.*?)\s*</pPort>", register[0])
        if port is not None and port[1] in foreign:
            return register[0]
        return re.sub(r"<(p?Length)>", rf"<Address>{shift:#x}</Address><\1>", register[0], count=1)

    return re.sub(r"0x[fF]{4}([0-9a-fA-F]{8})\b", r"0x\1", _REGISTER.sub(with_shift, text))


def _texts(node: ET.Element, tag: str) -> list[str]:
    return [(child.text or "").strip() for child in node.findall(tag)]


def _text(node: ET.Element, tag: str) -> str:
    text = node.findtext(tag)
    if text is None:
        raise DescriptionError(f"{node.get('Name')}: has no {tag}.")
    return text.strip()


def _number(node: ET.Element, tag: str, default: Number | None = None) -> Number:
    text = node.text if tag == "." else node.findtext(tag)
    if text is None:
        if default is None:
            raise DescriptionError(f"{node.get('Name')}: has no {tag}.")
        return default
    return number_of(text)

"""Read fiducials from the feature files of ODB++: pads with the attributes `.pad_usage` and `.fiducial_name`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from vaoi_station.board_data.design import Mark, MarkKind, Side
from vaoi_station.board_data.marks import kind_by_name
from vaoi_station.board_data.source_text import number_of

_USAGES: dict[str, MarkKind] = {"2": "global", "g_fiducial": "global", "3": "local", "l_fiducial": "local"}
"""Values of `.pad_usage` that mark fiducials; files state the number of the option."""
_COPPER = ("SIGNAL", "POWER_GROUND", "MIXED")
_SYMBOL = re.compile(r"(?:r|s|di|rect|oval|oct|hex_[ls]|donut_[a-z]+)(\d+(?:\.\d+)?)(?=$|x)", re.IGNORECASE)
"""Standard symbols, whose name states their size; `fid_100` of a design may have any."""
MOST_MARKS = 1_000


def outer_layers(matrix: Sequence[str]) -> dict[Side, str]:
    """Return the names of the outer copper layers, in lower case, from the lines of `matrix/matrix`."""
    found: list[tuple[float, str]] = []
    entry: dict[str, str] = {}
    for line in matrix:
        key, equals, value = line.strip().partition("=")
        if line.strip().startswith("LAYER"):
            entry = {}
        elif equals:
            entry[key] = value
        elif line.strip() == "}" and entry.get("TYPE", "").upper() in _COPPER:
            if (row := number_of(entry.get("ROW"))) is not None:
                found.append((row, entry.get("NAME", "").lower()))
            entry = {}
    if not found:
        return {}
    outer: dict[Side, str] = {"top": min(found)[1]}
    if len(found) > 1:
        outer["bottom"] = max(found)[1]
    return outer


def pad_marks(lines: Sequence[str], mm: float, side: Side) -> Iterator[Mark]:
    """Yield the pads of a copper layer that are fiducials.

    `mm` is the unit of the file; symbols are in a thousandth of it.
    """
    symbols: dict[str, float] = {}
    names: dict[str, str] = {}
    texts: dict[str, str] = {}
    count = 0
    for line in lines:
        if line.startswith("$"):
            words = line[1:].split()
            size = _SYMBOL.match(words[1]) if len(words) > 1 else None
            if size:
                unit = {"I": 25.4, "M": 1.0}.get(words[2] if len(words) > 2 else "", mm)
                symbols[words[0]] = float(size[1]) * unit / 1000
        elif match := re.match(r"([@&])(\d+)\s+(.*)", line):
            (names if match[1] == "@" else texts)[match[2]] = match[3].strip()
        elif line.startswith("P ") and ";" in line and count < MOST_MARKS:
            head, _, tail = line.partition(";")
            attributes = dict(_named(tail, names))
            name = texts.get(attributes.get(".fiducial_name", "?"), attributes.get(".fiducial_name"))
            usage = _USAGES.get(attributes.get(".pad_usage", ""))
            words = head.split()
            if (name is None and usage is None) or len(words) < 4:
                continue
            x, y = number_of(words[1]), number_of(words[2])
            if x is None or y is None:
                continue
            count += 1
            kind = usage or kind_by_name(name or "")
            yield Mark(name or f"{kind}{count}", side, (x * mm, y * mm), symbols.get(words[3]), kind, "attribute")


def _named(tail: str, names: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield name and value of the attributes of a feature: `;0=2,1;ID=7`."""
    for item in tail.split(";", maxsplit=1)[0].split(","):
        key, _, value = item.strip().partition("=")
        if key in names:
            yield names[key].lower(), value

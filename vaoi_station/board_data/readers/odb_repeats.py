"""Read the header of an ODB++ step (`stephdr`): its datum and its blocks `STEP-REPEAT`.

A block places the datum of a step at X, Y, and NX × NY times at distances DX, DY along the axes of the panel. The step
turns clockwise by ANGLE about its datum. With MIRROR or FLIP it lies upside down: it is mirrored in x before it turns.
Version 7 has MIRROR only. Source: ODB++ specification 8.1.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from vaoi_station.board_data.design import XY
from vaoi_station.board_data.panels import Repeat
from vaoi_station.board_data.source_text import number_of
from vaoi_station.errors import InputError

_BLOCK = re.compile(r"\s*STEP-REPEAT\s*\{?\s*$", re.IGNORECASE)
MOST_BLOCKS = 10_000
_Block = tuple[int, dict[str, str]]
"""Number of the first line, and key → value."""


def has_repeats(lines: Sequence[str]) -> bool:
    """Return whether the lines of a header have a block of step-and-repeat."""
    return any(_BLOCK.match(line) for line in lines)


def datum_of(where: str, lines: Sequence[str], mm: float) -> XY:
    """Return the datum of a step, from the lines of its header in units of `mm`.

    Raises:
        InputError: a value is no number, or a block has no end.
    """
    header: dict[str, str] = {}
    for _ in _blocks(where, lines, header):
        pass
    return _number(where, header, "X_DATUM") * mm, _number(where, header, "Y_DATUM") * mm


def repeats_of(where: str, lines: Sequence[str], mm: float) -> tuple[Repeat, ...]:
    """Return the repeats of a step, from the lines of its header in units of `mm`.

    Raises:
        InputError: a block has no name or no end, or a value is no number.
    """
    repeats = []
    for number, block in _blocks(where, lines, {}):
        at = f"{where}, STEP-REPEAT in line {number}"
        if not block.get("NAME"):
            raise InputError(f"{at}: has no NAME of a step.")
        repeats.append(
            Repeat(
                step=block["NAME"].lower(),
                first=(_number(at, block, "X") * mm, _number(at, block, "Y") * mm),
                pitch=(_number(at, block, "DX") * mm, _number(at, block, "DY") * mm),
                counts=(_count(at, block, "NX"), _count(at, block, "NY")),
                degrees=-_number(at, block, "ANGLE"),
                mirrored="YES" in (block.get("MIRROR", "").upper(), block.get("FLIP", "").upper()),
            )
        )
    return tuple(repeats)


def _blocks(where: str, lines: Sequence[str], header: dict[str, str]) -> Iterator[_Block]:
    """Yield the blocks of step-and-repeat; what stands outside of all blocks is added to `header`."""
    block: _Block | None = None
    count = 0
    for number, line in enumerate(lines, 1):
        key, equals, value = (word.strip() for word in line.partition("="))
        if _BLOCK.match(line):
            block, count = (number, {}), count + 1
            if count > MOST_BLOCKS:
                raise InputError.field(where, "the number of STEP-REPEAT", f"{count} or more", f"at most {MOST_BLOCKS}")
        elif key == "}":
            if block is not None:
                yield block
            block = None
        elif equals:
            (header if block is None else block[1])[key.upper()] = value
    if block is not None:
        raise InputError(f"{where}: STEP-REPEAT in line {block[0]} has no end, '}}'.")


def _number(where: str, values: dict[str, str], key: str) -> float:
    text = values.get(key, "0")
    found = number_of(text)
    if found is None:
        raise InputError.field(where, key, text, "a number")
    return found


def _count(where: str, values: dict[str, str], key: str) -> int:
    text = values.get(key, "1")
    if not re.fullmatch(r"\d{1,9}", text):
        raise InputError.field(where, key, text, "a whole number from 1")
    return int(text)

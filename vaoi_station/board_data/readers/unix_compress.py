"""Decompress files of Unix compress (`.Z`), as which ODB++ designs of version 7 keep their large members.

Format: LZW with codes of 9 to at most 16 bits, the lowest bit first. Codes come in groups of eight; when their width
changes, the rest of the group is padding. Code 256 empties the table, if the third byte of the file says so. Source:
what ncompress 4.2 writes, which the tests have.
"""

from __future__ import annotations

from pathlib import Path

from vaoi_station.errors import InputError

MAGIC = b"\x1f\x9d"
_CLEAR = 256


def decompress(data: bytes, where: str | Path, most_bytes: int) -> bytes:
    """Return the content of a compressed file; refuse one that is damaged or longer than the limit.

    The format has no checksum and no length: a file that was cut off is recognised by a rest of a code only.
    """
    widest = data[2] & 0x1F if len(data) > 2 else 0
    try:
        if data[:2] != MAGIC or not 10 <= widest <= 16:
            raise ValueError(f"its codes have {widest} bits, but must have 10 to 16")
        return _decompress(data, widest, bool(data[2] & 0x80), most_bytes)
    except ValueError as error:
        raise InputError(f"{where}: is no valid file of compress (.Z): {error}.") from error


def _decompress(data: bytes, widest: int, clears: bool, most_bytes: int) -> bytes:
    out = bytearray()
    # Each entry of the table repeats what was put out before: its begin and its length. Entries below 256 are bytes.
    table: list[tuple[int, int]] = [(0, 0)] * (_CLEAR + clears)
    width, group, at, end = 9, 24, 24, 8 * len(data)
    last: tuple[int, int] | None = None
    while at + width <= end:
        code = int.from_bytes(data[at >> 3 : (at + width + 7) >> 3], "little") >> (at & 7) & ((1 << width) - 1)
        at += width
        if clears and code == _CLEAR:
            # The first code after it makes an entry as well, in the place of code 256, which no code can name.
            del table[_CLEAR:]
            at = group = _end_of_group(at, group, width)
            width = 9
            continue
        begin = len(out)
        if code < 256:
            out.append(code)
        elif last is None or code > len(table):
            raise ValueError(f"names entry {code} of {len(table)} at byte {at >> 3}")
        elif code == len(table):  # the entry that this code itself makes: the last output and its first byte
            out += out[last[0] : last[0] + last[1]]
            out.append(out[last[0]])
        else:
            start, length = table[code]
            out += out[start : start + length]
        if len(out) > most_bytes:
            raise ValueError(f"is longer than {most_bytes} bytes")
        if last is not None and len(table) < 1 << widest:
            table.append((last[0], last[1] + 1))
        last = (begin, len(out) - begin)
        if len(table) > (1 << width) - 1 and width < widest:
            at = group = _end_of_group(at, group, width)
            width += 1
    if end - at >= 8 or (at < end and data[-1] >> (8 - (end - at))):
        raise ValueError("ends within a code")
    return bytes(out)


def _end_of_group(at: int, group: int, width: int) -> int:
    """Return the bit behind a group of eight codes; `group` is where groups of this width begin."""
    return group + -(-(at - group) // (8 * width)) * 8 * width

"""Decompress text of the JavaScript library LZ-String, in which InteractiveHtmlBom embeds its data.

Format: a stream of bits, the lowest first, in code words whose width grows with the dictionary. Words 0 and 1 introduce
a new character of 8 or 16 bits, 2 ends the text. Source: pieroxy/lz-string, its description of the format.
"""

from __future__ import annotations

import base64
import binascii
from pathlib import Path

from vaoi_station.errors import InputError

_NEW_8, _NEW_16, _END = 0, 1, 2


class _Bits:
    """Reads numbers from bytes, each bit of a byte from the highest, each number from its lowest bit."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self, width: int) -> int:
        found = 0
        for k in range(width):
            byte, bit = divmod(self._at, 8)
            if byte >= len(self._data):
                raise ValueError("ends within the text")
            found |= ((self._data[byte] >> (7 - bit)) & 1) << k
            self._at += 1
        return found


def decompress(text: str, where: str | Path, most_characters: int) -> str:
    """Return the text that `compressToBase64` has compressed; refuse one longer than the limit."""
    try:
        return _decompress(base64.b64decode(text, validate=True), most_characters)
    except (binascii.Error, ValueError, IndexError) as error:
        raise InputError(f"{where}: its compressed data are damaged: {error}.") from error


def _decompress(data: bytes, most_characters: int) -> str:
    bits = _Bits(data)
    words: list[str] = ["", "", ""]
    width, room = 3, 4  # `room`: new words until the width grows

    def new_character(code: int) -> str:
        return chr(bits.number(8 if code == _NEW_8 else 16))

    code = bits.number(2)
    if code == _END:
        return ""
    previous = new_character(code)
    words.append(previous)
    out, length = [previous], 1
    while True:
        code = bits.number(width)
        if code == _END:
            return "".join(out)
        if code in (_NEW_8, _NEW_16):
            words.append(new_character(code))
            code = len(words) - 1
            room -= 1
            if room == 0:
                room, width = 1 << width, width + 1
        if code < len(words):
            entry = words[code]
        elif code == len(words):
            entry = previous + previous[0]
        else:
            raise ValueError(f"names word {code} of {len(words)}")
        out.append(entry)
        length += len(entry)
        if length > most_characters:
            raise ValueError(f"is longer than {most_characters} characters")
        words.append(previous + entry[0])
        previous = entry
        room -= 1
        if room == 0:
            room, width = 1 << width, width + 1

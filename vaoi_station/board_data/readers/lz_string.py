"""Decompress text of the JavaScript library LZ-String, in which InteractiveHtmlBom embeds its data.

Format: a stream of bits in code words whose width grows with the dictionary, each word from its lowest bit. Words 0 and
1 introduce a new character of 8 or 16 bits, 2 ends the text. Source: pieroxy/lz-string, its description of the format.
"""

from __future__ import annotations

import base64
import binascii
from pathlib import Path

from vaoi_station.errors import InputError

_CHARACTER_BITS = {0: 8, 1: 16}
_END = 2


def decompress(text: str, where: str | Path, most_characters: int) -> str:
    """Return the text that `compressToBase64` has compressed; refuse one longer than the limit."""
    try:
        return _decompress(base64.b64decode(text, validate=True), most_characters)
    except (binascii.Error, ValueError, IndexError) as error:
        raise InputError(f"{where}: its compressed data are damaged: {error}.") from error


def _decompress(data: bytes, most_characters: int) -> str:
    at, end = 0, 8 * len(data)

    def number(width: int) -> int:
        nonlocal at
        if at + width > end:
            raise ValueError("ends within the text")
        found = 0
        for k in range(width):
            found |= ((data[at >> 3] >> (7 - (at & 7))) & 1) << k
            at += 1
        return found

    words: list[str] = ["", "", ""]
    width, room = 2, 1  # `room`: new words until the width grows
    out: list[str] = []
    previous, length = "", 0
    while (code := number(width)) != _END:
        if code in _CHARACTER_BITS:
            words.append(chr(number(_CHARACTER_BITS[code])))
            code = len(words) - 1
            room -= 1
            if room == 0:
                room, width = 1 << width, width + 1
        if code > len(words) or (code == len(words) and not previous):
            raise ValueError(f"names word {code} of {len(words)}")
        entry = words[code] if code < len(words) else previous + previous[0]
        out.append(entry)
        length += len(entry)
        if length > most_characters:
            raise ValueError(f"is longer than {most_characters} characters")
        if previous:
            words.append(previous + entry[0])
            room -= 1
            if room == 0:
                room, width = 1 << width, width + 1
        previous = entry
    return "".join(out)

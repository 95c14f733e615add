"""A compressor in the words of the format's description gives the texts; it is written from the description alone."""

from __future__ import annotations

import base64

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.readers.lz_string import decompress
from vaoi_station.errors import InputError


def compress(text: str) -> str:
    bits: list[int] = []
    words: dict[str, int] = {}
    new: set[str] = set()
    width, room = 2, 2

    def number(value: int, count: int) -> None:
        bits.extend((value >> k) & 1 for k in range(count))

    def grow() -> None:
        nonlocal width, room
        room -= 1
        if room == 0:
            room, width = 1 << width, width + 1

    def write(word: str) -> None:
        if word in new:
            new.discard(word)
            wide = ord(word) > 255
            number(int(wide), width)
            number(ord(word), 16 if wide else 8)
            grow()
        else:
            number(words[word], width)
        grow()

    current = ""
    for character in text:
        if character not in words:
            words[character] = len(words) + 3
            new.add(character)
        if current + character in words:
            current += character
        else:
            write(current)
            words[current + character] = len(words) + 3
            current = character
    if current:
        write(current)
    number(2, width)
    bits += [0] * (-len(bits) % 8)
    data = bytes(int("".join(map(str, bits[k : k + 8])), 2) for k in range(0, len(bits), 8))
    return base64.b64encode(data).decode()


@given(st.text(alphabet="abcde{}:µ€", max_size=200))
def test_texts_come_back(text: str) -> None:
    assert decompress(compress(text), "f", 1000) == text


def test_damaged_and_too_long_texts_are_refused() -> None:
    with pytest.raises(InputError, match="f: its compressed data are damaged: is longer than 50 characters"):
        decompress(compress("a" * 500), "f", 50)
    with pytest.raises(InputError, match="ends within the text"):
        decompress(compress("hello, world")[:8], "f", 50)
    with pytest.raises(InputError, match="damaged"):
        decompress("***", "f", 50)

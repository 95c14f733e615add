"""Huffman codes of residuals: small ones are symbols; of large ones the leading bits are, and the rest follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled

DIRECT = 64
"""Residuals below this, as unsigned numbers, are symbols; of larger ones the two leading bits."""
DIRECT_BITS = 6
SYMBOLS = DIRECT + 2 * 11
"""Number of symbols: residuals have at most 17 bits."""
LONGEST = 11
"""Largest length of a code in bits: the table of a decoder has 2^LONGEST entries for each kind."""


@compiled
def code_lengths(counts: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the length of each symbol's code, 0 for one that does not occur; at most LONGEST."""
    size = len(counts)
    lengths = np.zeros(size, np.uint8)
    weight = counts.copy()
    # Rare symbols are counted as more frequent until no code is too long.
    least = counts.sum() >> (LONGEST + 2)
    while True:
        nodes = np.zeros(2 * size, np.int64)
        parent = np.full(2 * size, -1, np.int64)
        nodes[:size] = weight
        made = size
        while True:
            # The two lightest nodes without a parent; of equal ones the first.
            one, two = -1, -1
            for k in range(made):
                if nodes[k] > 0 and parent[k] < 0:
                    if one < 0 or nodes[k] < nodes[one]:
                        one, two = k, one
                    elif two < 0 or nodes[k] < nodes[two]:
                        two = k
            if two < 0:
                break
            nodes[made] = nodes[one] + nodes[two]
            parent[one] = parent[two] = made
            made += 1
        longest = 0
        for k in range(size):
            depth, at = 0, k
            while parent[at] >= 0:
                depth, at = depth + 1, parent[at]
            # A symbol that is alone has a code of one bit, which nothing else uses.
            lengths[k] = 0 if counts[k] == 0 else max(depth, 1)
            longest = max(longest, depth)
        if longest <= LONGEST:
            return lengths
        least = 2 * least + 1
        for k in range(size):
            if counts[k] > 0:
                weight[k] = max(counts[k], least)


@compiled
def codes_of(lengths: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return the canonical code of each symbol, first bit lowest."""
    codes = np.zeros(len(lengths), np.uint32)
    code = 0
    for length in range(1, LONGEST + 1):
        for symbol in range(len(lengths)):
            if lengths[symbol] == length:
                for bit in range(length):
                    codes[symbol] |= np.uint32(((code >> bit) & 1) << (length - 1 - bit))
                code += 1
        code <<= 1
    return codes


@compiled
def decoding_table(lengths: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return symbol · 16 + length for each LONGEST bits of a stream; length 0 where no code begins so."""
    table = np.zeros(1 << LONGEST, np.uint16)
    codes = codes_of(lengths)
    for symbol in range(len(lengths)):
        length = np.int64(lengths[symbol])
        if length > 0:
            for at in range(np.int64(codes[symbol]), 1 << LONGEST, 1 << length):
                table[at] = symbol << 4 | length
    return table


def decoding_tables(lengths: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Return the tables of all kinds one after the other, with signed residuals · 16 + length.

    Symbols of large residuals stay as they are.
    """
    tables = np.concatenate([decoding_table(one) for one in lengths])
    symbol = (tables >> 4).astype(np.int16)
    signed = np.where(symbol < DIRECT, (symbol >> 1) ^ -(symbol & 1), symbol)
    return np.asarray(signed << 4 | (tables & 15).astype(np.int16), np.int16)


def packed_lengths(lengths: NDArray[np.uint8]) -> bytes:
    """Return the lengths of the codes of all kinds, two to a byte."""
    flat = lengths.reshape(-1)
    return (flat[::2] | flat[1::2] << 4).tobytes()


def unpacked_lengths(content: bytes, kinds: int) -> NDArray[np.uint8]:
    """Undo `packed_lengths`; ValueError if a length is impossible."""
    nibbles = np.frombuffer(content, np.uint8)
    lengths = np.stack([nibbles & 15, nibbles >> 4], -1).reshape(kinds, SYMBOLS)
    if lengths.max() > LONGEST:
        raise ValueError("the head of a plane is invalid")
    return lengths

"""Reads planes that version 1 of the format has stored; nothing writes them any more.

There the kind of a neighbourhood depended on the row of the pixel as well, and each kind had weights of its own.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.plant.archive.frames.huffman import (
    DIRECT,
    DIRECT_BITS,
    LONGEST,
    SYMBOLS,
    decoding_tables,
    unpacked_lengths,
)
from vaoi_station.plant.archive.frames.plane_reader import PlaneReader

_HEAD = struct.Struct("<BHII")
"""Step, largest value, words of the upper and of the lower strip."""
_KINDS = 8
"""Number of kinds of neighbourhoods; the first rows have a code besides."""
_WEIGHTS = 5
"""Weights of W, N, NW, NE, and a constant, times 2^_FRACTION_BITS."""
_FRACTION_BITS = 12
_ACTIVITIES = 1024
_MARGIN = 2
"""Margin on the left in steps; on the right it is one step."""
_WORST_BITS = LONGEST + 15
"""Largest number of bits of a pixel."""


def decode_former_plane(content: bytes, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Decode a plane; ValueError if the content is not that of such a plane."""
    reader = PlaneReader(content)
    step, largest, *counts = _HEAD.unpack(reader.take(_HEAD.size))
    bounds = np.frombuffer(reader.take(2 * (_KINDS - 1)), "<u2")
    weights = np.frombuffer(reader.take(4 * _KINDS * _WEIGHTS), "<i4").astype(np.int64)
    lengths = unpacked_lengths(reader.take((_KINDS + 1) * SYMBOLS // 2), _KINDS + 1)
    if step not in (1, 2):
        raise ValueError("the head of a plane is invalid")
    tables = decoding_tables(lengths)
    kinds = np.searchsorted(bounds, np.arange(_ACTIVITIES), side="right").astype(np.uint8)
    half = -(-shape[0] // (2 * step)) * step
    out = np.zeros((2 * half, shape[1] + (_MARGIN + 1) * step), np.uint16)
    # A row that is damaged reads at most this far beyond the end, before it is noticed.
    beyond = np.zeros(shape[1] * _WORST_BITS // 32 + 3, np.uint32)
    for strip, count in zip((out[:half], out[half:]), counts, strict=True):
        words = np.concatenate((np.frombuffer(reader.take(4 * count), "<u4"), beyond))
        if not _decode_strip(strip, (step, largest, count), kinds, weights, tables, words):
            raise ValueError("the numbers of a plane end too early")
    return out[: shape[0], _MARGIN * step : _MARGIN * step + shape[1]]


@compiled
def _decode_strip(
    out: NDArray[np.uint16],
    head: tuple[int, int, int],
    kinds: NDArray[np.uint8],
    weights: NDArray[np.int64],
    tables: NDArray[np.int16],
    words: NDArray[np.uint32],
) -> bool:
    """Fill a padded strip; return False if it ends too early. `head`: step, largest value, number of words."""
    step, largest, end = head
    shift = 0
    while largest >> (8 + shift):
        shift += 1
    left, right = _MARGIN * step, out.shape[1] - step
    ahead, bits, at = np.uint64(0), np.int64(0), 0
    for y in range(out.shape[0]):
        if y >= step:
            for k in range(step):
                out[y, k] = out[y, k + step] = out[y - step, left + k]
        for x in range(left, right):
            w = np.int64(out[y, x - step])
            kind, guess = np.int64(_KINDS), w
            if y >= 2 * step:
                n, nw, ne = (
                    np.int64(out[y - step, x]),
                    np.int64(out[y - step, x - step]),
                    np.int64(out[y - step, x + step]),
                )
                nn, ww = np.int64(out[y - 2 * step, x]), np.int64(out[y, x - 2 * step])
                rough = (abs(n - nw) + abs(n - ne) + abs(ww - nw) + abs(nn - n)) >> shift
                kind = np.int64(kinds[min(rough, np.int64(_ACTIVITIES - 1))])
                c = weights[kind * _WEIGHTS : (kind + 1) * _WEIGHTS]
                sum_of = c[0] * w + c[1] * n + c[2] * nw + c[3] * ne + c[4]
                guess = min(max(sum_of >> _FRACTION_BITS, np.int64(0)), np.int64(largest))
            if bits < 32:
                ahead |= np.uint64(words[at]) << np.uint64(bits)
                bits, at = bits + 32, at + 1
            entry = np.int64(tables[(kind << LONGEST) | np.int64(ahead & np.uint64((1 << LONGEST) - 1))])
            used, error = entry & 15, entry >> 4
            if error >= DIRECT:
                large = error - DIRECT
                rest = DIRECT_BITS - 1 + (large >> 1)
                unsigned = ((2 | (large & 1)) << rest) | np.int64(
                    (ahead >> np.uint64(used)) & np.uint64((1 << rest) - 1)
                )
                used += rest
                error = -(unsigned >> 1) - 1 if unsigned & 1 else unsigned >> 1
            out[y, x] = guess + error
            ahead >>= np.uint64(used)
            bits -= used
        for k in range(step):
            out[y, right + k] = out[y, right - step + k]
        if at > end + 1:
            return False
    return True

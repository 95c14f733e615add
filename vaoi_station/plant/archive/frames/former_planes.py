"""Reads planes that versions 1 and 2 of the format have stored; nothing writes them any more.

There a pixel was predicted from its left neighbour too. In version 1 each kind of neighbourhood had weights of its own.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.plant.archive.frames.bayer import in_order
from vaoi_station.plant.archive.frames.huffman import (
    DIRECT,
    DIRECT_BITS,
    LONGEST,
    SYMBOLS,
    decoding_tables,
    unpacked_lengths,
)
from vaoi_station.plant.archive.frames.plane_reader import PlaneReader

_HEADS = {1: struct.Struct("<BHII"), 2: struct.Struct("<BBII")}
"""Step, largest value (version 1) or shift of activities (version 2), words of the upper and of the lower strip."""
_KINDS = 8
"""Number of kinds of neighbourhoods; the first rows have a code besides."""
_WEIGHTS = 7
"""Weights of W, N, NW, NE, NN, NNE, and a constant, times 2^_FRACTION_BITS."""
_FRACTION_BITS = 12
_ACTIVITIES = 1024
_MARGIN = 2
"""Margin on the left in steps; on the right it is one step."""
_WORST_BITS = LONGEST + 15
"""Largest number of bits of a pixel."""


class _Model(NamedTuple):
    """How the pixels of one plane are predicted."""

    step: int
    shift: int
    largest: int
    """Predicted values are limited to this value; -1: they are not."""
    kinds: NDArray[np.uint8]
    """Kind of neighbourhood by its activity (_ACTIVITIES,)."""
    weights: NDArray[np.int32]
    """(_KINDS · _WEIGHTS,)."""


def decode_former_plane(content: bytes, shape: tuple[int, int], version: int) -> NDArray[np.uint16]:
    """Decode a plane of version 1 or 2; ValueError if the content is not that of such a plane."""
    reader, head = PlaneReader(content), _HEADS[version]
    step, parameter, *counts = head.unpack(reader.take(head.size))
    bounds = np.frombuffer(reader.take(2 * (_KINDS - 1)), "<u2")
    weights = _weights(reader, version)
    lengths = unpacked_lengths(reader.take((_KINDS + 1) * SYMBOLS // 2), _KINDS + 1)
    if step not in (1, 2) or (version == 2 and parameter > 8):
        raise ValueError("the head of a plane is invalid")
    kinds = np.searchsorted(bounds, np.arange(_ACTIVITIES), side="right").astype(np.uint8)
    if version == 1:
        model = _Model(step, max(parameter.bit_length() - 8, 0), parameter, kinds, weights)
    else:
        # Pixels of one colour lie side by side.
        model = _Model(1, parameter, -1, kinds, weights)
    tables = decoding_tables(lengths)
    half = -(-shape[0] // (2 * model.step)) * model.step
    out = np.zeros((2 * half, shape[1] + (_MARGIN + 1) * model.step), np.uint16)
    # A row that is damaged reads at most this far beyond the end, before it is noticed.
    beyond = np.zeros(shape[1] * _WORST_BITS // 32 + 3, np.uint32)
    for strip, count in zip((out[:half], out[half:]), counts, strict=True):
        words = np.concatenate((np.frombuffer(reader.take(4 * count), "<u4"), beyond))
        if not _decode_strip(strip, model, tables, words, count):
            raise ValueError("the numbers of a plane end too early")
    plane = out[: shape[0], _MARGIN * model.step : _MARGIN * model.step + shape[1]]
    return in_order(plane) if step > model.step else plane


def _weights(reader: PlaneReader, version: int) -> NDArray[np.int32]:
    """Return the weights of all kinds one after the other."""
    if version == 1:
        stored = np.frombuffer(reader.take(4 * _KINDS * 5), "<i4").reshape(_KINDS, 5)
        return np.insert(stored, [4, 4], 0, axis=1).astype(np.int32).reshape(-1)
    first, rise = np.frombuffer(reader.take(4 * 2 * _WEIGHTS), "<i4").reshape(2, _WEIGHTS).astype(np.int64)
    return (first + np.arange(_KINDS)[:, None] ** 2 * rise).astype(np.int32).reshape(-1)


@inlined
def _limited(sum_of, largest):  # type: ignore[no-untyped-def]
    """Return the predicted value of a weighted sum; without a largest value sums were taken modulo 2^32."""
    if largest < 0:
        return np.int64(np.int32(sum_of)) >> _FRACTION_BITS
    return min(max(sum_of >> _FRACTION_BITS, np.int64(0)), np.int64(largest))


@compiled
def _decode_strip(
    out: NDArray[np.uint16], model: _Model, tables: NDArray[np.int16], words: NDArray[np.uint32], end: int
) -> bool:
    """Fill a padded strip; return False if it ends too early. `end` is the number of its words."""
    step, shift, largest, kinds, weights = model
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
                nn, nne = np.int64(out[y - 2 * step, x]), np.int64(out[y - 2 * step, x + step])
                rough = abs(n - nw) + abs(n - ne) + abs(nn - n)
                if largest >= 0:
                    rough += abs(np.int64(out[y, x - 2 * step]) - nw)
                else:
                    rough += abs(np.int64(out[y - 2 * step, x - step]) - nw) + abs(nne - ne)
                kind = np.int64(kinds[min(rough >> shift, np.int64(_ACTIVITIES - 1))])
                c = weights[kind * _WEIGHTS : (kind + 1) * _WEIGHTS]
                guess = _limited(c[0] * w + c[1] * n + c[2] * nw + c[3] * ne + c[4] * nn + c[5] * nne + c[6], largest)
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

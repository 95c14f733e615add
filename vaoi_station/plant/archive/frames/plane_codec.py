"""Encodes one plane of 16-bit numbers, in two strips that are decoded side by side.

Each pixel depends on the one before it, so that a processor waits for every step of a single strip.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.plant.archive.frames.huffman import (
    DIRECT,
    DIRECT_BITS,
    LONGEST,
    SYMBOLS,
    code_lengths,
    codes_of,
    decoding_table,
)
from vaoi_station.plant.archive.frames.prediction import (
    ACTIVITIES,
    FIRST_ROWS,
    FRACTION_BITS,
    KINDS,
    MARGIN,
    WEIGHTS,
    Model,
    fit,
    padded,
    padded_shape,
    shift_of,
)

_HEAD = struct.Struct("<BHII")
"""Step, largest value, words of the upper and of the lower strip."""
_at = np.uint64
"""Index as an unsigned number: a signed one is checked for counting from the end, at every access."""
_WORST_BITS = LONGEST + 15
"""Largest number of bits of a pixel: the code, and what follows it."""


def encode_plane(plane: NDArray[np.uint16], step: int) -> bytes:
    """Encode a plane (height, width) with neighbours at a distance of `step` px."""
    out = padded(plane, step)
    model = fit(out, step)
    residuals, kinds, counts = _residuals(out.reshape(-1), out.shape[1], model)
    lengths = np.stack([code_lengths(one) for one in counts.reshape(KINDS + 1, SYMBOLS)])
    codes = np.concatenate([codes_of(one) for one in lengths])
    flat, half = lengths.reshape(-1), len(residuals) // 2
    strips = [_emit(residuals[part], kinds[part], codes, flat) for part in (slice(half), slice(half, None))]
    bounds = np.searchsorted(model.kinds, np.arange(1, KINDS)).astype("<u2")
    return b"".join(
        (
            _HEAD.pack(step, model.largest, *map(len, strips)),
            bounds.tobytes(),
            model.weights.astype("<i4").tobytes(),
            (flat[::2] | flat[1::2] << 4).tobytes(),
            *(strip.astype("<u4").tobytes() for strip in strips),
        )
    )


def decode_plane(content: bytes, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Decode a plane; ValueError if the content is not that of such a plane."""
    reader = _Reader(content)
    step, largest, *counts = _HEAD.unpack(reader.take(_HEAD.size))
    bounds = np.frombuffer(reader.take(2 * (KINDS - 1)), "<u2")
    weights = np.frombuffer(reader.take(4 * KINDS * WEIGHTS), "<i4").astype(np.int64)
    nibbles = np.frombuffer(reader.take((KINDS + 1) * SYMBOLS // 2), np.uint8)
    lengths = np.stack([nibbles & 15, nibbles >> 4], -1).reshape(KINDS + 1, SYMBOLS)
    if step not in (1, 2) or lengths.max() > LONGEST:
        raise ValueError("the head of a plane is invalid")
    kinds = np.searchsorted(bounds, np.arange(ACTIVITIES), side="right").astype(np.uint8)
    tables = np.concatenate([decoding_table(one) for one in lengths])
    # A row that is damaged reads at most this far beyond the end, before it is noticed.
    beyond = np.zeros(shape[1] * _WORST_BITS // 32 + 3, np.uint32)
    strips = [np.concatenate((np.frombuffer(reader.take(4 * n), "<u4"), beyond)) for n in counts]
    ends = (counts[0], len(strips[0]) + counts[1])
    out = np.zeros(padded_shape(shape, step), np.uint16)
    model = Model(step, largest, shift_of(largest), kinds, weights)
    if not _decode(out.reshape(-1), out.shape[1], model, tables, np.concatenate(strips), ends):
        raise ValueError("the numbers of a plane end too early")
    return out[: shape[0], MARGIN * step : MARGIN * step + shape[1]]


class _Reader:
    """Bytes that are taken one part after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def take(self, size: int) -> bytes:
        """Return the next bytes; ValueError if there are fewer."""
        part = self._content[self._at : self._at + size]
        self._at += size
        if len(part) < size:
            raise ValueError("a plane is shorter than its head says")
        return part


@compiled
def _residuals(
    out: NDArray[np.uint16], stride: int, model: Model
) -> tuple[NDArray[np.uint32], NDArray[np.uint8], NDArray[np.int64]]:
    """Return residuals as unsigned numbers, kinds of neighbourhoods, and counts of symbols by kind.

    The padded plane is given as one row of numbers; the first two returned arrays have its pixels one after the other.
    """
    step, largest, shift, kind_of, c = model.step, model.largest, model.shift, model.kinds, model.weights
    left, right, up = MARGIN * step, stride - step, step * stride
    rows = out.size // stride
    residuals = np.empty(rows * (right - left), np.uint32)
    kinds = np.empty(rows * (right - left), np.uint8)
    counts = np.zeros((KINDS + 1) * SYMBOLS, np.int64)
    k = 0
    for row in range(rows):
        fresh = row % (rows // 2) < 2 * step
        for p in range(row * stride + left, row * stride + right):
            w = np.int64(out[_at(p - step)])
            kind, guess = np.int64(FIRST_ROWS), w
            if not fresh:
                n, nw = np.int64(out[_at(p - up)]), np.int64(out[_at(p - up - step)])
                ne, ww = np.int64(out[_at(p - up + step)]), np.int64(out[_at(p - 2 * step)])
                nn = np.int64(out[_at(p - 2 * up)])
                rough = abs(n - nw) + abs(n - ne) + abs(ww - nw) + abs(nn - n)
                kind = np.int64(kind_of[_at(min(rough >> shift, np.int64(ACTIVITIES - 1)))])
                v = kind * WEIGHTS
                above = c[_at(v + 1)] * n + c[_at(v + 2)] * nw + c[_at(v + 3)] * ne + c[_at(v + 4)]
                guess = min(max((c[_at(v)] * w + above) >> FRACTION_BITS, np.int64(0)), np.int64(largest))
            error = np.int64(out[_at(p)]) - guess
            unsigned = (error << 1) ^ (error >> 63)
            residuals[_at(k)] = unsigned
            kinds[_at(k)] = kind
            k += 1
            counts[_at(kind * SYMBOLS + _symbol(unsigned))] += 1
    return residuals, kinds, counts


@inlined
def _symbol(unsigned):  # type: ignore[no-untyped-def]
    """Return the symbol of a residual."""
    symbol = unsigned
    if unsigned >= DIRECT:
        bits = DIRECT_BITS + 1
        while unsigned >> bits:
            bits += 1
        symbol = DIRECT + 2 * (bits - DIRECT_BITS - 1) + ((unsigned >> (bits - 2)) & 1)
    return symbol


@compiled
def _emit(
    residuals: NDArray[np.uint32], kinds: NDArray[np.uint8], codes: NDArray[np.uint32], lengths: NDArray[np.uint8]
) -> NDArray[np.uint32]:
    """Return the codes of a strip, first bit lowest, in words of 32 bits."""
    words = np.empty(residuals.size * _WORST_BITS // 32 + 2, np.uint32)
    pending, bits, at = np.uint64(0), np.int64(0), 0
    for k in range(residuals.size):
        unsigned = np.int64(residuals[_at(k)])
        symbol = _symbol(unsigned)
        code = np.int64(kinds[_at(k)]) * SYMBOLS + symbol
        pending |= np.uint64(codes[_at(code)]) << np.uint64(bits)
        bits += np.int64(lengths[_at(code)])
        if symbol >= DIRECT:
            rest = DIRECT_BITS - 1 + ((symbol - DIRECT) >> 1)
            pending |= np.uint64(unsigned & ((1 << rest) - 1)) << np.uint64(bits)
            bits += rest
        if bits >= 32:
            words[_at(at)] = np.uint32(pending & np.uint64(0xFFFFFFFF))
            pending >>= np.uint64(32)
            bits -= 32
            at += 1
    words[at] = np.uint32(pending & np.uint64(0xFFFFFFFF))
    return words[: at + 1].copy()


@compiled
def _decode(
    out: NDArray[np.uint16],
    stride: int,
    model: Model,
    tables: NDArray[np.uint16],
    words: NDArray[np.uint32],
    ends: tuple[int, int],
) -> bool:
    """Fill a padded plane, given as one row of numbers; return False if a strip ends too early.

    `words` has both strips, each with zeros for one row beyond its end; `ends` are these ends.
    """
    # Fields of a tuple are read once: in a loop each reading would count references.
    step, largest, shift, kind_of, c = model.step, model.largest, model.shift, model.kinds, model.weights
    left, right = MARGIN * step, stride - step
    half = out.size // 2
    # Of both strips: bits that were read ahead, their number, the next word. The strips take turns.
    ahead, other_ahead = np.uint64(0), np.uint64(0)
    bits, other_bits = np.int64(0), np.int64(0)
    at, other_at = np.int64(0), np.int64(ends[0] + (right - left) * _WORST_BITS // 32 + 3)
    for row in range(half // stride):
        line, other_line = row * stride, row * stride + half
        if row >= step:
            for k in range(step):
                out[line + k] = out[line + k + step] = out[line - step * stride + left + k]
                out[other_line + k] = out[other_line + k + step] = out[other_line - step * stride + left + k]
        up = step * stride
        fresh = row < 2 * step
        for x in range(left, right):
            for _ in range(2):
                p = line + x
                if bits < 32:
                    ahead |= np.uint64(words[_at(at)]) << np.uint64(bits)
                    bits += 32
                    at += 1
                w = np.int64(out[_at(p - step)])
                kind, guess = np.int64(FIRST_ROWS), w
                if not fresh:
                    n, nw = np.int64(out[_at(p - up)]), np.int64(out[_at(p - up - step)])
                    ne, ww = np.int64(out[_at(p - up + step)]), np.int64(out[_at(p - 2 * step)])
                    nn = np.int64(out[_at(p - 2 * up)])
                    rough = abs(n - nw) + abs(n - ne) + abs(ww - nw) + abs(nn - n)
                    kind = np.int64(kind_of[_at(min(rough >> shift, np.int64(ACTIVITIES - 1)))])
                    v = kind * WEIGHTS
                    above = c[_at(v + 1)] * n + c[_at(v + 2)] * nw + c[_at(v + 3)] * ne + c[_at(v + 4)]
                    guess = min(max((c[_at(v)] * w + above) >> FRACTION_BITS, np.int64(0)), np.int64(largest))
                entry = np.int64(tables[_at((kind << LONGEST) | np.int64(ahead & np.uint64((1 << LONGEST) - 1)))])
                used, unsigned = entry & 15, entry >> 4
                if unsigned >= DIRECT:
                    large = unsigned - DIRECT
                    rest = DIRECT_BITS - 1 + (large >> 1)
                    low = np.int64((ahead >> np.uint64(used)) & np.uint64((1 << rest) - 1))
                    unsigned = ((2 | (large & 1)) << rest) | low
                    used += rest
                out[_at(p)] = guess + ((unsigned >> 1) ^ -(unsigned & 1))
                ahead, other_ahead = other_ahead, ahead >> np.uint64(used)
                bits, other_bits = other_bits, bits - used
                at, other_at = other_at, at
                line, other_line = other_line, line
        for k in range(step):
            out[line + right + k] = out[line + right - step + k]
            out[other_line + right + k] = out[other_line + right - step + k]
        if at > ends[0] + 1 or other_at > ends[1] + 1:
            return False
    return True

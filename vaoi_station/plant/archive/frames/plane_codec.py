"""Encodes one plane of 16-bit numbers, in two strips that are decoded side by side.

Each pixel depends on the one before it, so that a processor waits for every step of a single strip.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.files.images import Image
from vaoi_station.plant.archive.frames.huffman import (
    DIRECT,
    DIRECT_BITS,
    LONGEST,
    SYMBOLS,
    code_lengths,
    codes_of,
    decoding_tables,
    packed_lengths,
    unpacked_lengths,
)
from vaoi_station.plant.archive.frames.plane_reader import PlaneReader
from vaoi_station.plant.archive.frames.prediction import (
    ACTIVITIES,
    BLIND_ROWS,
    FRACTION_BITS,
    KINDS,
    MARGIN,
    WEIGHTS,
    Context,
    Model,
    fill_context,
    fit,
    new_context,
    padded,
    padded_shape,
)

_HEAD = struct.Struct("<BBII")
"""Step, shift of activities, words of the upper and of the lower strip."""
_index = np.uint64
"""Index as an unsigned number: a signed one is checked for counting from the end, at every access."""
_WORST_BITS = LONGEST + 14
"""Largest number of bits of a pixel: the code, and what follows it."""
_LENGTH, _FOLLOWING = 16, 24
"""First bits of the length of a code, and of the number of bits that follow it, in an entry of the encoder's table."""
_LARGE = np.maximum(np.arange(SYMBOLS) - DIRECT, 0) // 2 + (DIRECT_BITS - 1) * (np.arange(SYMBOLS) >= DIRECT)
_REST = np.tile(_LARGE.astype(np.uint32) << _FOLLOWING, KINDS + 1)
"""Numbers of bits that follow the codes, as part of the entries."""
_CODE = np.uint64((1 << LONGEST) - 1)
_WORD = np.uint64(32)


def encode_plane(plane: Image, step: int) -> bytes:
    """Encode a plane (height, width) with neighbours at a distance of `step` px."""
    out = padded(_sorted_by_colour(plane) if step == 2 else plane)
    model = fit(out)
    which, large, upper, counts = _residuals(out.reshape(-1), out.shape[1], model, new_context(plane.shape[1]))
    lengths = np.stack([code_lengths(one) for one in counts.reshape(KINDS + 1, SYMBOLS)])
    flat, half = lengths.reshape(-1), len(which) // 2
    codes = np.concatenate([codes_of(one) for one in lengths]) | flat.astype(np.uint32) << _LENGTH | _REST
    strips = [_emit(which[:half], large[:upper], codes), _emit(which[half:], large[upper:], codes)]
    bounds = np.searchsorted(model.kinds, np.arange(1, KINDS)).astype("<u2")
    return b"".join(
        (
            _HEAD.pack(step, model.shift, *map(len, strips)),
            bounds.tobytes(),
            model.weights.astype("<i4").tobytes(),
            packed_lengths(lengths),
            *(strip.astype("<u4", copy=False).data for strip in strips),
        )
    )


def decode_plane(content: bytes, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Decode a plane; ValueError if the content is not that of such a plane."""
    reader = PlaneReader(content)
    step, shift, *counts = _HEAD.unpack(reader.take(_HEAD.size))
    bounds = np.frombuffer(reader.take(2 * (KINDS - 1)), "<u2")
    weights = np.frombuffer(reader.take(4 * 2 * WEIGHTS), "<i4").astype(np.int32)
    lengths = unpacked_lengths(reader.take((KINDS + 1) * SYMBOLS // 2), KINDS + 1)
    if step not in (1, 2) or shift > 8:
        raise ValueError("the head of a plane is invalid")
    kinds = np.searchsorted(bounds, np.arange(ACTIVITIES), side="right").astype(np.uint8)
    # A row that is damaged reads at most this far beyond the end, before it is noticed.
    beyond = np.zeros(shape[1] * _WORST_BITS // 32 + 3, np.uint32)
    strips = [np.concatenate((np.frombuffer(reader.take(4 * n), "<u4"), beyond)) for n in counts]
    out = np.zeros(padded_shape(shape), np.uint16)
    contexts = new_context(shape[1]), new_context(shape[1])
    model, tables, words = Model(shift, kinds, weights), decoding_tables(lengths), np.concatenate(strips)
    if not _decode(out.reshape(-1), model, contexts, tables, words, (counts[0], len(strips[0]) + counts[1])):
        raise ValueError("the numbers of a plane end too early")
    plane = out[: shape[0], MARGIN:-MARGIN]
    return _in_order(plane) if step == 2 else plane


def _order(size: int) -> NDArray[np.intp]:
    return np.concatenate((np.arange(0, size, 2), np.arange(1, size, 2)))


def _sorted_by_colour(plane: Image) -> Image:
    """Return a plane whose neighbours have filters of the same colour: even rows and columns come first."""
    return plane[_order(plane.shape[0])[:, None], _order(plane.shape[1])]


def _in_order(plane: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Undo `_sorted_by_colour`."""
    out = np.empty_like(plane)
    out[_order(plane.shape[0])[:, None], _order(plane.shape[1])] = plane
    return out


@compiled
def _residuals(
    out: NDArray[np.uint16], stride: int, model: Model, context: Context
) -> tuple[NDArray[np.uint16], NDArray[np.uint16], int, NDArray[np.int64]]:
    """Return kind · SYMBOLS + symbol of each pixel, and of residuals that are no symbols the unsigned numbers.

    The padded plane is given as one row of numbers. The third value is the number of such residuals in the upper strip,
    the fourth how often each of the first values occurs.
    """
    kind, left, above = context.kind, context.left, context.above
    m, rows = stride - 2 * MARGIN, out.size // stride
    which = np.empty(rows * m, np.uint16)
    # Memory that is not written is not there: few residuals are large.
    large, many, upper = np.empty(rows * m, np.uint16), 0, 0
    found = np.empty(m, np.uint16)
    counts = np.zeros((KINDS + 1) * SYMBOLS, np.int64)
    first_left, first_above = left.copy(), above.copy()
    for row in range(rows):
        p = row * stride + MARGIN
        if row == rows // 2:
            upper = many
        if row % (rows // 2) >= BLIND_ROWS:
            fill_context(out, p, stride, model, context)
        else:
            kind[:], left[:], above[:] = KINDS, first_left, first_above
        one, w = out[p : p + m], out[p - 1 : p - 1 + m]
        for k in range(m):
            guess = np.int32(left[k] * np.int32(w[k]) + above[k]) >> np.int32(FRACTION_BITS)
            # Modulo 2^16: what is predicted beyond the range of a pixel costs no longer code.
            error = np.int16(np.int32(one[k]) - guess)
            found[k] = np.uint16(np.int32(error) << np.int32(1)) ^ np.uint16(error >> np.int32(15))
        code = which[row * m : (row + 1) * m]
        for k in range(m):
            symbol = np.int64(found[k])
            if symbol >= DIRECT:
                large[_index(many)] = found[k]
                many += 1
                symbol = _large_symbol(symbol)
            entry = np.int64(kind[k]) * SYMBOLS + symbol
            code[k] = entry
            counts[_index(entry)] += 1
    return which, large[:many], upper, counts


@inlined
def _large_symbol(unsigned):  # type: ignore[no-untyped-def]
    """Return the symbol of a residual that is none itself."""
    bits = DIRECT_BITS + 1
    while unsigned >> bits:
        bits += 1
    return DIRECT + 2 * (bits - DIRECT_BITS - 1) + ((unsigned >> (bits - 2)) & 1)


@compiled
def _emit(which: NDArray[np.uint16], large: NDArray[np.uint16], codes: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the codes of a strip, first bit lowest, in words of 32 bits."""
    words = np.empty(which.size * _WORST_BITS // 32 + 2, np.uint32)
    pending, bits, at, many = np.uint64(0), np.uint64(0), np.uint64(0), 0
    for k in range(which.size):
        entry = np.uint64(codes[_index(which[_index(k)])])
        pending |= (entry & np.uint64((1 << _LENGTH) - 1)) << bits
        bits += (entry >> np.uint64(_LENGTH)) & np.uint64(0xFF)
        rest = entry >> np.uint64(_FOLLOWING)
        if rest:
            pending |= (np.uint64(large[_index(many)]) & ((np.uint64(1) << rest) - np.uint64(1))) << bits
            bits += rest
            many += 1
        # The word is written whether it is full or not: a branch would be mispredicted at every full one.
        words[at] = np.uint32(pending & np.uint64(0xFFFFFFFF))
        full = bits >> np.uint64(5)
        at += full
        pending >>= full << np.uint64(5)
        bits &= np.uint64(31)
    words[at] = np.uint32(pending & np.uint64(0xFFFFFFFF))
    return words[: np.int64(at) + 1].copy()


@inlined
def _residual(entry, ahead, bits, word):  # type: ignore[no-untyped-def]
    """Return the residual of an entry of the decoder's tables, what is left of the bits, and whether it took `word`.

    `ahead` has the bits that were read ahead, `bits` their number, `word` those that follow.
    """
    used, error = np.uint64(entry & 15), entry >> 4
    ahead, bits, took = ahead >> used, bits - used, np.uint64(0)
    if error >= DIRECT:
        took = np.uint64(bits < _WORD)
        ahead, bits = ahead | word << bits, bits + took * _WORD
        large = error - DIRECT
        rest = DIRECT_BITS - 1 + (large >> 1)
        unsigned = ((2 | (large & 1)) << rest) | np.int64(ahead & np.uint64((1 << rest) - 1))
        ahead, bits = ahead >> np.uint64(rest), bits - np.uint64(rest)
        error = -(unsigned >> 1) - 1 if unsigned & 1 else unsigned >> 1
    return error, ahead, bits, took


@compiled
def _decode(
    out: NDArray[np.uint16],
    model: Model,
    contexts: tuple[Context, Context],
    tables: NDArray[np.int16],
    words: NDArray[np.uint32],
    ends: tuple[int, int],
) -> bool:
    """Fill a padded plane, given as one row of numbers; return False if a strip ends too early.

    `words` has both strips, each with zeros for one row beyond its end; `ends` are these ends.
    """
    # Fields of a tuple are read once: in a loop each reading would count references.
    one, other = contexts
    kind, left, above = one.kind, one.left, one.above
    other_kind, other_left, other_above = other.kind, other.left, other.above
    m, half = kind.size, out.size // 2
    stride = m + 2 * MARGIN
    # Of both strips: bits that were read ahead, their number, the next word. The strips take turns.
    ahead, other_ahead = np.uint64(0), np.uint64(0)
    bits, other_bits = np.uint64(0), np.uint64(0)
    at, other_at = np.uint64(0), np.uint64(ends[0] + m * _WORST_BITS // 32 + 3)
    for row in range(half // stride):
        p, q = row * stride + MARGIN, row * stride + MARGIN + half
        if row:
            out[p - 1], out[q - 1] = out[p - stride], out[q - stride]
        if row >= BLIND_ROWS:
            fill_context(out, p, stride, model, one)
            fill_context(out, q, stride, model, other)
        w, v = np.int64(out[p - 1]), np.int64(out[q - 1])
        for k in range(m):
            if k & 1 == 0:
                # 32 bits hold the codes of two pixels. The next word may be there already, for a part: the same bits
                # once more change nothing.
                ahead |= np.uint64(words[at]) << bits
                fresh = np.uint64(bits < _WORD)
                at, bits = at + fresh, bits + fresh * _WORD
                other_ahead |= np.uint64(words[other_at]) << other_bits
                fresh = np.uint64(other_bits < _WORD)
                other_at, other_bits = other_at + fresh, other_bits + fresh * _WORD
            entry = np.int64(tables[_index(np.uint64(kind[k]) << np.uint64(LONGEST) | ahead & _CODE)])
            error, ahead, bits, took = _residual(entry, ahead, bits, np.uint64(words[at]))
            at += took
            w = ((np.int32(left[k] * np.int32(w) + above[k]) >> np.int32(FRACTION_BITS)) + error) & 0xFFFF
            out[_index(p + k)] = w
            entry = np.int64(tables[_index(np.uint64(other_kind[k]) << np.uint64(LONGEST) | other_ahead & _CODE)])
            error, other_ahead, other_bits, took = _residual(entry, other_ahead, other_bits, np.uint64(words[other_at]))
            other_at += took
            v = ((np.int32(other_left[k] * np.int32(v) + other_above[k]) >> np.int32(FRACTION_BITS)) + error) & 0xFFFF
            out[_index(q + k)] = v
        out[p + m], out[q + m] = w, v
        if at > ends[0] + 1 or other_at > ends[1] + 1:
            return False
    return True

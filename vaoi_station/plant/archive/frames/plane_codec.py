"""Encodes one plane of 16-bit numbers, in four streams whose pixels take turns in each row.

A code's place is known when the one before it in its stream was read: a processor waits for a single stream.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.files.images import Image
from vaoi_station.plant.archive.frames.bayer import in_order, sorted_by_colour
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
    GROUP,
    KINDS,
    MARGIN,
    TOP,
    WEIGHTS,
    Context,
    Model,
    empty_plane,
    fill_context,
    fit,
    padded,
)

_STREAMS = 4
_HEAD = struct.Struct("<BH4I")
"""Step, value above the plane, bytes of each stream."""
_WORST_BITS = LONGEST + 14
"""Largest number of bits of a pixel: the code, and what follows it."""
_LENGTH, _FOLLOWING = 16, 24
"""First bits of the length of a code, and of the number of bits that follow it, in an entry of the encoder's table."""
_LARGE = np.maximum(np.arange(SYMBOLS) - DIRECT, 0) // 2 + (DIRECT_BITS - 1) * (np.arange(SYMBOLS) >= DIRECT)
_REST = np.tile(_LARGE.astype(np.uint32) << _FOLLOWING, KINDS)
"""Numbers of bits that follow the codes, as part of the entries."""
_index = np.uint64
"""Index as an unsigned number: a signed one is checked for counting from the end, at every access."""
_CODE = np.uint64((1 << LONGEST) - 1)


def encode_plane(plane: Image, step: int) -> bytes:
    """Encode a plane (height, width) with neighbours at a distance of `step` px."""
    out = padded(sorted_by_colour(plane) if step == 2 else plane)
    model = fit(out)
    # numpy takes large arrays in huge pages; those of compiled functions would cost a fault for each 4 kB.
    which = np.empty(plane.shape[0] * (out.shape[1] - 2 * MARGIN), np.uint16)
    residuals, words = np.empty_like(which), np.empty(which.size // _STREAMS * _WORST_BITS // 32 + 2, np.uint32)
    counts = _symbols(out.reshape(-1), out.shape[1], model, which, residuals)
    lengths = np.stack([code_lengths(one) for one in counts.reshape(KINDS, SYMBOLS)])
    entries = lengths.reshape(-1).astype(np.uint32) << _LENGTH | _REST
    codes = np.concatenate([codes_of(one) for one in lengths]) | entries
    streams = [
        words[: _emit(which, residuals, codes, first, words)].astype("<u4", copy=False).tobytes()
        for first in range(_STREAMS)
    ]
    return b"".join(
        (
            _HEAD.pack(step, int(out[0, 0]), *map(len, streams)),
            model.bounds.astype("<u2").tobytes(),
            model.weights.astype("<i4").tobytes(),
            packed_lengths(lengths),
            *streams,
        )
    )


def decode_plane(content: bytes, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Decode a plane; ValueError if the content is not that of such a plane."""
    reader = PlaneReader(content)
    step, level, *sizes = _HEAD.unpack(reader.take(_HEAD.size))
    bounds = np.frombuffer(reader.take(2 * (KINDS - 1)), "<u2").astype(np.uint16)
    weights = np.frombuffer(reader.take(4 * 2 * WEIGHTS), "<i4").astype(np.int32)
    lengths = unpacked_lengths(reader.take(KINDS * SYMBOLS // 2), KINDS)
    if step not in (1, 2):
        raise ValueError("the head of a plane is invalid")
    out = empty_plane(shape, level)
    # A row that is damaged reads at most this far beyond the end of a stream, before it is noticed.
    beyond = bytes(out.shape[1] * _WORST_BITS // 8)
    streams = b"".join(part for size in sizes for part in (reader.take(size), beyond))
    # At each byte, what follows it as one number.
    windows: NDArray[np.uint64] = np.ndarray(len(streams) - 8, "<u8", streams, strides=(1,))
    ends = np.cumsum(sizes) + np.arange(_STREAMS) * len(beyond)
    begins = ends - sizes
    model, tables = Model(bounds, weights), decoding_tables(lengths)
    if not _decode(out.reshape(-1), out.shape[1], model, tables, windows, (begins, ends)):
        raise ValueError("the numbers of a plane end too early")
    plane = out[TOP:, MARGIN : MARGIN + shape[1]]
    return in_order(plane) if step == 2 else plane


@compiled
def _symbols(
    out: NDArray[np.uint16], stride: int, model: Model, which: NDArray[np.uint16], residuals: NDArray[np.uint16]
) -> NDArray[np.int64]:
    """Fill `which` with kind · SYMBOLS + symbol of each pixel, `residuals` with unsigned numbers; return frequencies.

    The padded plane is given as one row of numbers. The frequencies are those of the numbers in `which`.
    """
    m, rows = stride - 2 * MARGIN, out.size // stride - TOP
    context = Context(np.empty(m, np.uint16), np.empty(m, np.uint16))
    kind, guess = context.kind, context.guess
    # Two, in turns: a count that was just written is not yet there to be read.
    counts, other_counts = np.zeros(KINDS * SYMBOLS, np.int64), np.zeros(KINDS * SYMBOLS, np.int64)
    for row in range(rows):
        p = (row + TOP) * stride + MARGIN
        fill_context(out, p, stride, model, SYMBOLS, context)
        one, found, code = out[p : p + m], residuals[row * m : (row + 1) * m], which[row * m : (row + 1) * m]
        for k in range(m):
            # Modulo 2^16: what is predicted beyond the range of a pixel costs no longer code.
            error = np.int16(one[k] - guess[k])
            found[k] = np.uint16(error << np.int16(1)) ^ np.uint16(error >> np.int16(15))
            code[k] = np.uint16(kind[k] + min(found[k], np.uint16(DIRECT)))
        at = _index(0)
        for _ in range(m // 2):
            if found[at] >= DIRECT:
                code[at] += np.uint16(_large_symbol(np.int64(found[at])) - DIRECT)
            counts[_index(code[at])] += 1
            at += _index(1)
            if found[at] >= DIRECT:
                code[at] += np.uint16(_large_symbol(np.int64(found[at])) - DIRECT)
            other_counts[_index(code[at])] += 1
            at += _index(1)
    return counts + other_counts


@inlined
def _large_symbol(unsigned):  # type: ignore[no-untyped-def]
    """Return the symbol of a residual that is none itself."""
    bits = DIRECT_BITS + 1
    while unsigned >> bits:
        bits += 1
    return DIRECT + 2 * (bits - DIRECT_BITS - 1) + ((unsigned >> (bits - 2)) & 1)


@compiled
def _emit(
    which: NDArray[np.uint16],
    residuals: NDArray[np.uint16],
    codes: NDArray[np.uint32],
    first: int,
    words: NDArray[np.uint32],
) -> int:
    """Fill `words` with the codes of every fourth pixel from `first` on, first bit lowest; return their number."""
    pending, bits, at = np.uint64(0), np.uint64(0), np.uint64(0)
    for k in range(first, which.size, _STREAMS):
        entry = np.uint64(codes[_index(which[_index(k)])])
        pending |= (entry & np.uint64((1 << _LENGTH) - 1)) << bits
        bits += (entry >> np.uint64(_LENGTH)) & np.uint64(0xFF)
        rest = entry >> np.uint64(_FOLLOWING)
        if rest:
            pending |= (np.uint64(residuals[_index(k)]) & ((np.uint64(1) << rest) - np.uint64(1))) << bits
            bits += rest
        # The word is written whether it is full or not: a branch would be mispredicted at every full one.
        words[at] = np.uint32(pending & np.uint64(0xFFFFFFFF))
        full = bits >> np.uint64(5)
        at += full
        pending >>= full << np.uint64(5)
        bits &= np.uint64(31)
    words[at] = np.uint32(pending & np.uint64(0xFFFFFFFF))
    return int(np.int64(at) + 1)


@inlined
def _residual(entry, bits, at):  # type: ignore[no-untyped-def]
    """Return the residual of an entry of the decoder's tables, the bits that follow it, and their place."""
    used, error = np.uint64(entry & 15), entry >> 4
    bits, at = bits >> used, at + used
    if error >= DIRECT:
        large = error - DIRECT
        rest = DIRECT_BITS - 1 + (large >> 1)
        unsigned = ((2 | (large & 1)) << rest) | np.int64(bits & np.uint64((1 << rest) - 1))
        bits, at = bits >> np.uint64(rest), at + np.uint64(rest)
        error = -(unsigned >> 1) - 1 if unsigned & 1 else unsigned >> 1
    return error, bits, at


@compiled
def _decode(
    out: NDArray[np.uint16],
    stride: int,
    model: Model,
    tables: NDArray[np.int16],
    windows: NDArray[np.uint64],
    spans: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> bool:
    """Fill a padded plane, given as one row of numbers; return False if a stream ends too early.

    `spans` has the bytes at which each stream begins and ends; beyond an end there are zeros for one row.
    """
    begins, ends = spans
    m, eight = stride - 2 * MARGIN, np.uint64(8)
    context = Context(np.empty(m, np.uint16), np.empty(m, np.uint16))
    kind, guess = context.kind, context.guess
    # The place of each stream's next bit.
    at, at_1 = np.uint64(8 * begins[0]), np.uint64(8 * begins[1])
    at_2, at_3 = np.uint64(8 * begins[2]), np.uint64(8 * begins[3])
    for row in range(TOP, out.size // stride):
        p = row * stride + MARGIN
        fill_context(out, p, stride, model, 1 << LONGEST, context)
        k, q = _index(0), _index(p)
        for _ in range(m // GROUP):
            # At least 57 bits, which hold two pixels of any length.
            bits, bits_1 = windows[at // eight] >> at % eight, windows[at_1 // eight] >> at_1 % eight
            bits_2, bits_3 = windows[at_2 // eight] >> at_2 % eight, windows[at_3 // eight] >> at_3 % eight
            for _ in range(GROUP // _STREAMS):
                error, bits, at = _residual(np.int64(tables[_index(kind[k]) | bits & _CODE]), bits, at)
                out[q] = np.uint16(np.int64(guess[k]) + error)
                k, q = k + _index(1), q + _index(1)
                error, bits_1, at_1 = _residual(np.int64(tables[_index(kind[k]) | bits_1 & _CODE]), bits_1, at_1)
                out[q] = np.uint16(np.int64(guess[k]) + error)
                k, q = k + _index(1), q + _index(1)
                error, bits_2, at_2 = _residual(np.int64(tables[_index(kind[k]) | bits_2 & _CODE]), bits_2, at_2)
                out[q] = np.uint16(np.int64(guess[k]) + error)
                k, q = k + _index(1), q + _index(1)
                error, bits_3, at_3 = _residual(np.int64(tables[_index(kind[k]) | bits_3 & _CODE]), bits_3, at_3)
                out[q] = np.uint16(np.int64(guess[k]) + error)
                k, q = k + _index(1), q + _index(1)
        out[p - 1], out[p + m] = out[p], out[p + m - 1]
        if at > 8 * ends[0] or at_1 > 8 * ends[1] or at_2 > 8 * ends[2] or at_3 > 8 * ends[3]:
            return False
    return True

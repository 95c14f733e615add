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
_MOST_ROUGH = 4 * 65536
"""Activities are less than this, also those of a damaged plane."""
_LENGTH, _FOLLOWING = 16, 24
"""First bits of the length of a code, and of the number of bits that follow it, in an entry of the encoder's table."""
_LARGE = np.maximum(np.arange(SYMBOLS) - DIRECT, 0) // 2 + (DIRECT_BITS - 1) * (np.arange(SYMBOLS) >= DIRECT)
_REST = np.tile(_LARGE.astype(np.uint32) << _FOLLOWING, KINDS + 1)
"""Numbers of bits that follow the codes, as part of the entries."""


def encode_plane(plane: Image, step: int) -> bytes:
    """Encode a plane (height, width) with neighbours at a distance of `step` px."""
    out = padded(plane, step)
    model = fit(out, step)
    which, large, upper, counts = _residuals(out.reshape(-1), out.shape[1], model)
    lengths = np.stack([code_lengths(one) for one in counts.reshape(KINDS + 1, SYMBOLS)])
    flat, half = lengths.reshape(-1), len(which) // 2
    codes = np.concatenate([codes_of(one) for one in lengths]) | flat.astype(np.uint32) << _LENGTH | _REST
    strips = [_emit(which[:half], large[:upper], codes), _emit(which[half:], large[upper:], codes)]
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
    tables = _with_signs(np.concatenate([decoding_table(one) for one in lengths]))
    # A row that is damaged reads at most this far beyond the end, before it is noticed.
    beyond = np.zeros(shape[1] * _WORST_BITS // 32 + 3, np.uint32)
    strips = [np.concatenate((np.frombuffer(reader.take(4 * n), "<u4"), beyond)) for n in counts]
    ends = (counts[0], len(strips[0]) + counts[1])
    out = np.zeros(padded_shape(shape, step), np.uint16)
    model = Model(step, largest, shift_of(largest), kinds, weights)
    # A kind for each activity, not for each step of it: nothing is shifted or limited for each pixel.
    kind_of = np.full(_MOST_ROUGH, kinds[-1], np.uint8)
    kind_of[: ACTIVITIES << model.shift] = np.repeat(kinds, 1 << model.shift)
    whole = model._replace(kinds=kind_of)
    if not _decode(out.reshape(-1), out.shape[1], whole, tables, np.concatenate(strips), ends):
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


@inlined
def _roughness(n, nw, ne, nn, ww):  # type: ignore[no-untyped-def]
    """Return the activity of a neighbourhood."""
    return abs(n - nw) + abs(n - ne) + abs(ww - nw) + abs(nn - n)


@inlined
def _guess(c, v, w, n, nw, ne, largest):  # type: ignore[no-untyped-def]
    """Return the predicted value of a pixel: `c` from index `v` on are the weights of its kind of neighbourhood."""
    above = c[_at(v + 1)] * n + c[_at(v + 2)] * nw + c[_at(v + 3)] * ne + c[_at(v + 4)]
    return min(max((c[_at(v)] * w + above) >> FRACTION_BITS, np.int64(0)), np.int64(largest))


@compiled
def _residuals(
    out: NDArray[np.uint16], stride: int, model: Model
) -> tuple[NDArray[np.uint16], NDArray[np.uint32], int, NDArray[np.int64]]:
    """Return kind · SYMBOLS + symbol of each pixel, and of residuals that are no symbols the unsigned numbers.

    The padded plane is given as one row of numbers. The third value is the number of such residuals in the upper strip,
    the fourth how often each of the first values occurs.
    """
    step, largest, kind_of, c = model.step, model.largest, model.kinds, model.weights
    shift, top = np.int32(model.shift), np.int32(ACTIVITIES - 1)
    left, up, m = MARGIN * step, step * stride, stride - (MARGIN + 1) * step
    rows = out.size // stride
    which = np.empty(rows * m, np.uint16)
    # Memory that is not written is not there: few residuals are large.
    large, many, upper = np.empty(rows * m, np.uint32), 0, 0
    found = np.empty(m, np.uint32)
    counts = np.zeros((KINDS + 1) * SYMBOLS, np.int64)
    for row in range(rows):
        p = row * stride + left
        one, w = out[p : p + m], out[p - step : p - step + m]
        code = which[row * m : (row + 1) * m]
        if row == rows // 2:
            upper = many
        if row % (rows // 2) < 2 * step:
            for k in range(m):
                error = np.int64(one[k]) - np.int64(w[k])
                found[k], code[k] = np.uint32((error << 1) ^ (error >> 63)), FIRST_ROWS
        else:
            # One loop for each quantity, so that the compiler uses vector registers where it can.
            n, nw, ne = out[p - up : p - up + m], out[p - up - step : p - up - step + m], out[p - up + step :]
            nn, ww = out[p - 2 * up : p - 2 * up + m], out[p - 2 * step : p - 2 * step + m]
            for k in range(m):
                rough = _roughness(np.int32(n[k]), np.int32(nw[k]), np.int32(ne[k]), np.int32(nn[k]), np.int32(ww[k]))
                code[k] = np.uint16(min(rough >> shift, top))
            for k in range(m):
                code[k] = kind_of[_at(code[k])]
            for k in range(m):
                v = np.int64(code[k]) * WEIGHTS
                guess = _guess(c, v, np.int64(w[k]), np.int64(n[k]), np.int64(nw[k]), np.int64(ne[k]), largest)
                error = np.int64(one[k]) - guess
                found[k] = np.uint32((error << 1) ^ (error >> 63))
        for k in range(m):
            symbol = _symbol(np.int64(found[k]))
            if symbol >= DIRECT:
                large[_at(many)] = found[k]
                many += 1
            entry = np.int64(code[k]) * SYMBOLS + symbol
            code[k] = entry
            counts[_at(entry)] += 1
    return which, large[:many], upper, counts


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
def _emit(which: NDArray[np.uint16], large: NDArray[np.uint32], codes: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the codes of a strip, first bit lowest, in words of 32 bits."""
    words = np.empty(which.size * _WORST_BITS // 32 + 2, np.uint32)
    pending, bits, at, many = np.uint64(0), np.uint64(0), np.uint64(0), 0
    for k in range(which.size):
        entry = np.uint64(codes[_at(which[_at(k)])])
        pending |= (entry & np.uint64((1 << _LENGTH) - 1)) << bits
        bits += (entry >> np.uint64(_LENGTH)) & np.uint64(0xFF)
        rest = entry >> np.uint64(_FOLLOWING)
        if rest:
            pending |= (np.uint64(large[_at(many)]) & ((np.uint64(1) << rest) - np.uint64(1))) << bits
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


def _with_signs(tables: NDArray[np.uint16]) -> NDArray[np.int16]:
    """Return tables of a decoder with signed residuals · 16 + length; symbols of large residuals stay as they are."""
    symbol = (tables >> 4).astype(np.int16)
    signed = np.where(symbol < DIRECT, (symbol >> 1) ^ -(symbol & 1), symbol)
    return np.asarray(signed << 4 | (tables & 15).astype(np.int16), np.int16)


@inlined
def _residual(tables, kind, ahead):  # type: ignore[no-untyped-def]
    """Return the residual at the beginning of the bits that were read ahead, and the number of its bits."""
    entry = np.int64(tables[_at((kind << LONGEST) | np.int64(ahead & np.uint64((1 << LONGEST) - 1)))])
    used, error = entry & 15, entry >> 4
    if error >= DIRECT:
        large = error - DIRECT
        rest = DIRECT_BITS - 1 + (large >> 1)
        unsigned = ((2 | (large & 1)) << rest) | np.int64((ahead >> np.uint64(used)) & np.uint64((1 << rest) - 1))
        used = used + rest
        error = -(unsigned >> 1) - 1 if unsigned & 1 else unsigned >> 1
    return error, used


@inlined
def _predicted(out, p, step, up, kind_of, c, largest):  # type: ignore[no-untyped-def]
    """Return the kind of the neighbourhood of a pixel, and its predicted value."""
    n, nw, ne = np.int64(out[_at(p - up)]), np.int64(out[_at(p - up - step)]), np.int64(out[_at(p - up + step)])
    kind = np.int64(
        kind_of[_at(_roughness(n, nw, ne, np.int64(out[_at(p - 2 * up)]), np.int64(out[_at(p - 2 * step)])))]
    )
    return kind, _guess(c, kind * WEIGHTS, np.int64(out[_at(p - step)]), n, nw, ne, largest)


@compiled
def _decode(
    out: NDArray[np.uint16],
    stride: int,
    model: Model,
    tables: NDArray[np.int16],
    words: NDArray[np.uint32],
    ends: tuple[int, int],
) -> bool:
    """Fill a padded plane, given as one row of numbers; return False if a strip ends too early.

    `model` has a kind for each activity below _MOST_ROUGH. `words` has both strips, each with zeros for one row beyond
    its end; `ends` are these ends.
    """
    # Fields of a tuple are read once: in a loop each reading would count references.
    step, largest, kind_of, c = model.step, model.largest, model.kinds, model.weights
    left, right, up = MARGIN * step, stride - step, step * stride
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
        fresh = row < 2 * step
        for x in range(left, right):
            p, q = line + x, other_line + x
            if bits < 32:
                ahead |= np.uint64(words[_at(at)]) << np.uint64(bits)
                bits += 32
                at += 1
            kind, guess = np.int64(FIRST_ROWS), np.int64(out[_at(p - step)])
            if not fresh:
                kind, guess = _predicted(out, p, step, up, kind_of, c, largest)
            error, used = _residual(tables, kind, ahead)
            out[_at(p)] = guess + error
            ahead >>= np.uint64(used)
            bits -= used
            if other_bits < 32:
                other_ahead |= np.uint64(words[_at(other_at)]) << np.uint64(other_bits)
                other_bits += 32
                other_at += 1
            kind, guess = np.int64(FIRST_ROWS), np.int64(out[_at(q - step)])
            if not fresh:
                kind, guess = _predicted(out, q, step, up, kind_of, c, largest)
            error, used = _residual(tables, kind, other_ahead)
            out[_at(q)] = guess + error
            other_ahead >>= np.uint64(used)
            other_bits -= used
        for k in range(step):
            out[line + right + k] = out[line + right - step + k]
            out[other_line + right + k] = out[other_line + right - step + k]
        if at > ends[0] + 1 or other_at > ends[1] + 1:
            return False
    return True

"""Codes are prefix-free, of limited length, and near the entropy."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.plant.archive.frames.huffman import (
    LONGEST,
    SYMBOLS,
    code_lengths,
    codes_of,
    decoding_table,
    packed_lengths,
    unpacked_lengths,
)

COUNTS = {
    "even": np.full(SYMBOLS, 5),
    "steep": 2 ** np.minimum(np.arange(SYMBOLS), 50),
    "one": np.eye(SYMBOLS, dtype=np.int64)[3],
    "two": 9 * (np.arange(SYMBOLS) < 2),
    "none": np.zeros(SYMBOLS),
}


@pytest.mark.parametrize("name", COUNTS)
def test_every_symbol_is_decoded_from_its_code(name: str) -> None:
    counts = COUNTS[name].astype(np.int64)
    lengths = code_lengths(counts)
    assert np.array_equal(lengths > 0, counts > 0)
    assert lengths.max() <= LONGEST
    table = decoding_table(lengths)
    for symbol in np.flatnonzero(counts):
        assert (table[codes_of(lengths)[symbol] :: 1 << int(lengths[symbol])] == symbol << 4 | lengths[symbol]).all()


def test_the_mean_length_is_near_the_entropy() -> None:
    counts = np.rint(1e5 * 0.8 ** np.arange(SYMBOLS)).astype(np.int64) + 1
    share = counts / counts.sum()
    assert (share * code_lengths(counts)).sum() < -(share * np.log2(share)).sum() + 0.08


def test_lengths_of_codes_come_back_and_impossible_ones_are_refused() -> None:
    lengths = np.stack([code_lengths(counts.astype(np.int64)) for counts in COUNTS.values()])[:2]
    assert np.array_equal(unpacked_lengths(packed_lengths(lengths), 2), lengths)
    with pytest.raises(ValueError, match="head of a plane is invalid"):
        unpacked_lengths(packed_lengths(lengths + 4), 2)

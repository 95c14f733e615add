"""Weights are those of least squares, and kinds cover every activity."""

from __future__ import annotations

import numpy as np

from vaoi_station.plant.archive.frames.prediction import ACTIVITIES, FRACTION_BITS, KINDS, WEIGHTS, fit, padded


def test_a_plane_with_a_slope_is_predicted_exactly() -> None:
    y, x = np.mgrid[:64, :64]
    model = fit(padded((3 * x + 2 * y).astype(np.uint16), 1), 1)
    weights = model.weights.reshape(KINDS, WEIGHTS)[int(model.kinds[3 + 3 + 3 + 2 - 3])] / (1 << FRACTION_BITS)
    w, n, nw, ne = 3 * 9 + 20, 3 * 10 + 18, 3 * 9 + 18, 3 * 11 + 18
    assert int(weights @ [w, n, nw, ne, 1]) == 3 * 10 + 20


def test_kinds_rise_with_the_activity_and_exist_for_all() -> None:
    plane = np.random.default_rng(1).integers(100, 4000, (40, 40)).astype(np.uint16)
    kinds = fit(padded(plane, 2), 2).kinds.astype(int)
    assert len(kinds) == ACTIVITIES
    assert (np.diff(kinds) >= 0).all()
    assert kinds.min() == 0
    assert kinds.max() < KINDS


def test_margins_repeat_what_a_decoder_knows() -> None:
    out = padded(np.arange(1, 25, dtype=np.uint16).reshape(4, 6), 1)
    assert out.shape == (4, 9)
    assert out[1].tolist() == [1, 1, 7, 8, 9, 10, 11, 12, 12]
    assert out[2, :2].tolist() == [0, 0]

"""Weights are those of least squares, and kinds cover every activity."""

from __future__ import annotations

import numpy as np

from vaoi_station.plant.archive.frames.prediction import (
    ACTIVITIES,
    FRACTION_BITS,
    KINDS,
    WEIGHTS,
    fill_context,
    fit,
    new_context,
    padded,
)


def test_a_plane_with_a_slope_is_predicted_exactly() -> None:
    y, x = np.mgrid[:64, :64]
    plane = (3 * x + 2 * y).astype(np.uint16)
    out, context = padded(plane), new_context(64)
    fill_context(out.reshape(-1), 10 * 66 + 1, 66, fit(out), context)
    guess = (context.left[1:-1] * plane[10, :-2] + context.above[1:-1]) >> FRACTION_BITS
    assert guess.tolist() == plane[10, 1:-1].tolist()


def test_the_context_is_that_of_the_formula() -> None:
    plane = np.random.default_rng(2).integers(0, 200, (40, 30)).astype(np.uint16)
    out, context = padded(plane), new_context(30)
    model = fit(out)
    fill_context(out.reshape(-1), 7 * 32 + 1, 32, model, context)
    p = out.astype(np.int64)
    n, nw, ne = p[6, 1:-1], p[6, :-2], p[6, 2:]
    nn, nnw, nne = p[5, 1:-1], p[5, :-2], p[5, 2:]
    rough = abs(n - nw) + abs(n - ne) + abs(nn - n) + abs(nnw - nw) + abs(nne - ne)
    kind = model.kinds[np.minimum(rough >> model.shift, ACTIVITIES - 1)].astype(np.int64)
    flat, rise = model.weights.astype(np.int64).reshape(2, WEIGHTS)
    c = flat + kind[:, None] ** 2 * rise
    assert context.kind.tolist() == kind.tolist()
    assert context.left.tolist() == c[:, 0].tolist()
    assert context.above.tolist() == (c[:, 1:] * np.stack([n, nw, ne, nn, nne, np.ones(30, int)], 1)).sum(1).tolist()


def test_kinds_rise_with_the_activity_and_exist_for_all() -> None:
    plane = np.random.default_rng(1).integers(100, 4000, (40, 40)).astype(np.uint16)
    kinds = fit(padded(plane)).kinds.astype(int)
    assert len(kinds) == ACTIVITIES
    assert (np.diff(kinds) >= 0).all()
    assert kinds.min() == 0
    assert kinds.max() < KINDS


def test_margins_repeat_what_a_decoder_knows() -> None:
    out = padded(np.arange(1, 19, dtype=np.uint16).reshape(3, 6))
    assert out.shape == (4, 8)
    assert out[1].tolist() == [1, 7, 8, 9, 10, 11, 12, 12]
    assert out[2, 0] == 0
    assert out[3].tolist() == [13, 13, 14, 15, 16, 17, 18, 18]

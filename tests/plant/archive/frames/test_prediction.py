"""Weights are those of least squares, and a row is predicted from the two above it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.plant.archive.frames.prediction import (
    FRACTION_BITS,
    KINDS,
    TOP,
    WEIGHTS,
    Context,
    Model,
    fill_context,
    fit,
    padded,
)


def context_of(out: NDArray[np.uint16], model: Model, row: int, unit: int = 1) -> Context:
    """Return the context of a row of a padded plane."""
    width = out.shape[1] - 2
    context = Context(np.empty(width, np.uint16), np.empty(width, np.uint16))
    fill_context(out.reshape(-1), row * out.shape[1] + 1, out.shape[1], model, unit, context)
    return context


def test_a_plane_with_a_slope_is_predicted_exactly() -> None:
    y, x = np.mgrid[:64, :64]
    plane = (3 * x + 2 * y).astype(np.uint16)
    out = padded(plane)
    assert context_of(out, fit(out), 10 + TOP).guess[1:-1].tolist() == plane[10, 1:-1].tolist()


def test_the_context_is_that_of_the_formula() -> None:
    out = padded(np.random.default_rng(2).integers(0, 200, (40, 32)).astype(np.uint16))
    model = fit(out)
    context = context_of(out, model, 7, unit=86)
    p = out.astype(np.int64)
    n, nw, ne = p[6, 1:-1], p[6, :-2], p[6, 2:]
    nn, nnw, nne = p[5, 1:-1], p[5, :-2], p[5, 2:]
    rough = abs(n - nw) + abs(n - ne) + abs(nn - n) + abs(nnw - nw) + abs(nne - ne)
    kind = (rough[:, None] > model.bounds.astype(np.int64)).sum(1)
    flat, rise = model.weights.astype(np.int64).reshape(2, WEIGHTS)
    weights = flat + kind[:, None] ** 2 * rise
    neighbours = np.stack([n, nw, ne, nn, nnw, nne, np.ones(32, int)], 1)
    assert context.kind.tolist() == (86 * kind).tolist()
    assert context.guess.tolist() == (((weights * neighbours).sum(1) >> FRACTION_BITS) % 65536).tolist()


def test_each_kind_has_its_share_of_the_pixels() -> None:
    out = padded(np.random.default_rng(1).integers(100, 4000, (80, 80)).astype(np.uint16))
    model = fit(out)
    assert (np.diff(model.bounds.astype(int)) > 0).all()
    kinds = np.concatenate([context_of(out, model, row).kind for row in range(2 * TOP, len(out))])
    shares = np.bincount(kinds, minlength=KINDS) / kinds.size
    assert abs(shares - 1 / KINDS).max() < 0.02


def test_around_a_plane_lies_what_a_decoder_knows() -> None:
    out = padded(np.arange(1, 19, dtype=np.uint16).reshape(3, 6))
    assert out.shape == (5, 10)
    assert out[:2].tolist() == [[3] * 10] * 2
    assert out[3].tolist() == [7, 7, 8, 9, 10, 11, 12, 12, 12, 12]

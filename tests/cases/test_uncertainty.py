"""Recorded boards: predicted uncertainty against real errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.cases

NAMES = (
    "paper-1", "paper-2", "paper-3", "ulx3s-top", "sparse", "dark", "hdr", "distorted", "fixture", "repetitive",
    "hdr-wide", "hdr-rows", "lights",
)  # fmt: skip


def lengths(result: Any, truth: dict[str, Any]) -> np.ndarray:
    """Compute the length of every view's error in standard deviations, by the covariance of that view."""
    found = {(ref, i, j): (x, y) for ref, views in result.components.items() for i, j, x, y in views}
    said = result.quality["component_covariance_px2"]
    covariance = {(ref, i, j): [[xx, xy], [xy, yy]] for ref, views in said.items() for i, j, xx, xy, yy in views}
    out = []
    for ref, views in truth["views"].items():
        for i, j, x, y in views:
            if (ref, i, j) in covariance:
                e = np.subtract(found[ref, i, j], (x, y))
                out.append(np.sqrt(e @ np.linalg.solve(covariance[ref, i, j], e)))
    return np.array(out)


def test_position_errors_match_their_covariances(cases: Any) -> None:
    runs = [lengths(cases.stitched(name), cases.truth(name)) for name in NAMES]
    normalised = [float((r**2).mean() / 2) for r in runs]
    print({name: round(v, 2) for name, v in zip(NAMES, normalised, strict=True)})
    assert 0.5 < np.mean(normalised) < 1.6
    assert (np.concatenate(runs) > 3).mean() < 0.02


def test_matrix_errors_match_their_sigmas(cases: Any) -> None:
    """Compare the middle of each frame; row 0 is left out, because it is exact by definition."""
    squares = []
    for name in ("ulx3s-top", "hdr", "repetitive", "fixture"):
        result, truth = cases.stitched(name), cases.truth(name)
        assert not np.array(result.quality["row_covariance"][0]).any()
        for i, rows in enumerate(result.quality["matrix_sigma_px"]):
            assert rows[0] == [0, 0]
            for j, sigma in enumerate(rows[1:], 1):
                middle = np.array([695.5, 519.5, 1.0])
                there = np.linalg.solve(truth["image_matrices"][i][j], middle)
                ours = result.image_matrices[i][j] @ there
                squares.append((np.hypot(*(ours[:2] / ours[2] - middle[:2])) / sigma[0]) ** 2)
                assert sigma[1] >= sigma[0] * 0.99, "the sigma at a corner is not smaller"
    print(np.mean(squares))
    assert 0.2 < np.mean(squares) < 4.0, "a sigma is that of the worst direction"

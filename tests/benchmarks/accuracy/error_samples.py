"""Runs with errors drawn from known distributions."""

from __future__ import annotations

import numpy as np

from vaoi_station.benchmarks.accuracy.consistency import RunErrors


def normal_errors(seed: int, real_px: float, predicted_px: float, views: int = 4000) -> RunErrors:
    """Return a run whose real and predicted standard deviations are given; along y both are doubled."""
    g = np.random.default_rng(seed)
    covariance = np.tile(np.diag([predicted_px**2, 4 * predicted_px**2]), (views, 1, 1))
    error = g.normal(0, 1, (views, 2)) * (real_px, 2 * real_px)
    return RunErrors("normal", "ok", error, covariance, np.zeros(0), np.zeros(0))


def without_cad_matrix() -> RunErrors:
    """Return a run whose CAD matrix was not found."""
    return RunErrors("lost", "failed", np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0))

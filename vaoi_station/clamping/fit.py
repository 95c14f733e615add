"""Fit the places of fiducials as filmed to those that a tester reads: a rigid motion, and a small change of shape.

A bend of the board moves its surface by half the thickness times the slope. For a bow of second degree this is an
affine displacement, so that the change of shape has it too, beside the scale and the axes of the tester.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply

SHIFT, TURN, SCALE, STRETCH, SHEAR = slice(0, 2), 2, 3, 4, 5
FREE = 1e3
"""Prior standard deviation, mm or rad, of what readings alone determine."""


def basis(arm: Floats) -> Floats:
    """Return the displacements (k, 2, 6) of points `arm` (k, 2) from the pivot by one unit of each parameter."""
    (x, y), out = arm.T, np.zeros((len(arm), 2, 6))
    out[:, 0, 0] = out[:, 1, 1] = 1.0
    out[:, 0, TURN], out[:, 1, TURN] = -y, x
    out[:, 0, SCALE], out[:, 1, SCALE] = x, y
    out[:, 0, STRETCH], out[:, 1, STRETCH] = x, -y
    out[:, 0, SHEAR], out[:, 1, SHEAR] = y, x
    return out


@dataclass(frozen=True, eq=False)
class Fit:
    """Clamped coordinates of places as filmed, mm."""

    matrix: Floats
    """(3, 3) clamped from filmed."""
    pivot: Floats
    """(2,) clamped coordinates of the point about which turn and change of shape are stated."""
    values: Floats
    """(6,) shift (0 by choice of the matrix), turn against the start, scale, stretch and shear."""
    covariance: Floats
    """(6, 6) of these."""
    prior: Floats
    """(6,) standard deviations that were assumed of them beforehand."""

    def sigma(self, places: Floats) -> Floats:
        """Return the covariances (k, 2, 2) of clamped places (k, 2)."""
        j = basis(places - self.pivot)
        return np.asarray(j @ self.covariance @ j.swapaxes(1, 2))

    def variance(self, places: Floats) -> Floats:
        """Return the variances (k, 2) of x and y of clamped places (k, 2)."""
        j = basis(places - self.pivot)
        return np.asarray(((j @ self.covariance) * j).sum(-1))

    def exceeded(self, limit: float) -> list[int]:
        """Return the parameters of shape that readings show to be larger than assumed, by `limit` σ."""
        # What the readings have told of a value has the variance by which they have lessened its prior.
        told = np.sqrt(np.maximum(self.prior**2 - self.covariance.diagonal(), 0.0))
        return [n for n in (SCALE, STRETCH, SHEAR) if abs(float(self.values[n])) > limit * max(float(told[n]), 1e-12)]

    def sigma_free(self, n: int) -> float:
        """Return the standard deviation of a parameter by the readings alone; infinite if they do not show it."""
        own = float(self.covariance[n, n]) ** -1 - float(self.prior[n]) ** -2
        return own**-0.5 if own > 1e-6 * float(self.prior[n]) ** -2 else np.inf


def fit(start: Floats, filmed: Floats, read: Floats, sigma: Floats, prior: Floats) -> Fit:
    """Improve a transform by readings, all of which are trusted.

    Args:
        start: (3, 3) clamped from filmed, rigid, so near that the turn which is left is small.
        filmed: (k, 2) places, k ≥ 1.
        read: (k, 2) where they were read.
        sigma: (k,) standard deviation of `read` − `start`(`filmed`), per axis.
        prior: (6,) standard deviations of the parameters beforehand.
    """
    places = apply(start, filmed)
    weight = sigma**-2.0
    pivot = np.asarray(weight @ places / weight.sum())
    j = basis(places - pivot)
    weighted = j * weight[:, None, None]
    normal = weighted.reshape(-1, 6).T @ j.reshape(-1, 6) + np.diag(prior**-2.0)
    covariance: Floats = np.asarray(np.linalg.inv(normal), np.float64)
    values = covariance @ (weighted.reshape(-1, 6).T @ (read - places).ravel())
    _, _, t, s, p, q = values.tolist()
    change = np.eye(3)
    change[:2, :2] += ((s + p, q - t), (q + t, s - p))
    change[:2, 2] = pivot + values[SHIFT] - change[:2, :2] @ pivot
    return Fit(np.asarray(change @ start), pivot + values[SHIFT], values, covariance, prior)


def left_out(found: Fit, filmed: Floats, read: Floats, sigma: Floats) -> tuple[Floats, Floats]:
    """Return how far each reading (k, 2) lies from where the others expect it, and that in standard deviations (k,).

    NaN where the others expect nothing: of a single reading, or of one without which a direction is free.
    """
    at = apply(found.matrix, filmed)
    # Without a reading of its own, a place is (1 − H)⁻¹ as far off as with it.
    left = np.eye(2) - found.sigma(at) / (sigma**2)[:, None, None]
    known = np.linalg.eigvalsh(left).min(axis=1) > 1e-6
    off, sigmas = np.full((len(at), 2), np.nan), np.full(len(at), np.nan)
    off[known] = np.linalg.solve(left[known], (read - at)[known, :, None])[..., 0]
    squares = np.einsum("ki,kij,kj->k", off[known], left[known], off[known]) / sigma[known] ** 2
    # Two directions: a distance of √2 in the mean.
    sigmas[known] = np.sqrt(np.maximum(squares, 0.0))
    return off, sigmas


def refined(found: Fit, filmed: Floats, read: Floats, sigma: Floats, prior: Floats) -> Fit:
    """Return the transform of a part of the board, which has moved against the whole by little, by its own readings."""
    own = fit(found.matrix, filmed, read, sigma, prior)
    return replace(own, values=own.values + np.r_[0.0, 0.0, found.values[2:]])

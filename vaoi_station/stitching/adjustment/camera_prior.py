"""The prior of the cameras' displacements, and the attribution of motion to as few cameras as possible.

Links between neighbouring cameras show how these cameras moved against one another. Links do not show a motion of the
whole array. A stretch of the array along the row of cameras looks to them like boards that lie higher. A camera is
either where it was calibrated, to a few hundredths of a pixel, or it was moved by an unknown amount. This knowledge is
a prior with heavy tails for each camera: Student's t distribution with one degree of freedom. Under this prior, of all
displacements that explain the links, those in which most cameras have not moved are the most likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.displacement import PARAMETERS
from vaoi_station.geometry.transforms import Floats

STILL_PX = 0.03
"""Standard deviation, over many runs, of the displacement of a camera that was not moved, for each of x, y and turn."""
MOVED_PX = 2 * STILL_PX
"""Length of the displacement vector (x, y, turn) above which a camera counts as moved."""
_WIDE_PX = 100.0
_ITERATIONS = 40
_SAME_PX = 0.01
"""Two explanations whose displacements differ by at most this are the same one."""
_CLOSE = 10.0
"""Difference of log-probability up to which two explanations count as equally good.

Such explanations can name different cameras. Only keystone distortion could decide between them. A camera shows it
after a turn, but not after a shift."""
_PUSHED_SHARE, _PUSHED_PX = 0.07, 0.1
"""Share of cameras that were pushed along x (or along y, or turned), and standard deviation of such a displacement.

Together they are 0.03 px rms, as `STILL_PX`. With a smaller share or width, errors under pushed cameras would be too
long in units of σ; with larger ones, σ under cameras that have not moved would be too large
(docs/measured/uncertainty.md)."""
_BLIND_PX, _PUSHED_BLIND_PX = 0.2, 0.35
"""Standard deviation, px, above which links do not show where a camera lies across its neighbours' seams, and the width
of a push that they then would not show.

Along the row of cameras a board that is lifted explains any push. Across it, only a blank overlap hides one: then a
camera may have been pushed further than what an overlap would have shown on earlier boards (seed 106038)."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """The most likely displacements of n cameras, their covariance, and the cameras that may have moved instead."""

    displacement_px: Floats
    """(n, 3) displacement x, y and turn of each camera."""
    covariance: Floats
    """(3n, 3n) covariance of the displacements, px², camera by camera."""
    rivals: tuple[int, ...] = ()
    """Cameras that have moved in another, equally good explanation, but have not moved in this one."""
    spread: Floats | None = None
    """(3n, 3n) px², mean square of the differences of all good explanations from this one, weighted by probability."""

    @property
    def moved(self) -> tuple[int, ...]:
        """Cameras whose displacement exceeds `MOVED_PX`."""
        return tuple(np.flatnonzero(np.hypot.reduce(self.displacement_px, axis=1) > MOVED_PX).tolist())

    @property
    def sigma_px(self) -> Floats:
        """Standard deviations (n, 3) of the displacements."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(-1, PARAMETERS))


def attribute_motion(information: Floats, vector: Floats, still_px: float | Floats = STILL_PX) -> Attribution:
    """Find which of n cameras were displaced, and how far, in a way that gives the same cameras for many runs.

    Different cameras can explain the same links. Of equally probable explanations, the one with the lowest camera
    numbers is returned, so that every run names the same camera.

    Args:
        information: (3n, 3n) px⁻², normal matrix of the displacements, without their prior.
        vector: (3n,) px⁻¹, right-hand side of the same normal equations.
        still_px: standard deviation of the displacement of a camera that was not moved, for all or for each (n,).
    """
    good = _explanations(information, vector, still_px)
    alike = _of_as_many_cameras(good)
    return _with_rivals(min(alike, key=lambda a: a.moved) if good[0][1].moved else good[0][1], good)


def most_likely_motion(information: Floats, vector: Floats, still_px: Floats) -> Attribution:
    """Find the most likely displacements of n cameras, for the same arguments as `attribute_motion`."""
    good = _explanations(information, vector, still_px)
    return _with_rivals(good[0][1], good)


def _explanations(information: Floats, vector: Floats, still_px: float | Floats) -> list[tuple[float, Attribution]]:
    """Find the good explanations, the most likely first, each with its negative log-probability."""
    # The probability has several maxima, so one search starts from each camera as the only fixed one, and one from each
    # camera as the only moved one.
    n = len(vector) // PARAMETERS
    tight, wide = 1 / np.broadcast_to(still_px, n) ** 2, np.full(n, 1 / _WIDE_PX**2)
    starts = [np.where(np.arange(n) == still, tight, wide) for still in range(n)]
    starts += [np.where(np.arange(n) == moved, wide, tight) for moved in range(n)]
    found = sorted((_maximum(information, vector, weight, still_px) for weight in starts), key=lambda f: f[0])
    good: list[tuple[float, Attribution]] = []
    for cost, a in found:
        known = any(np.abs(a.displacement_px - other.displacement_px).max() < _SAME_PX for _, other in good)
        if cost < found[0][0] + _CLOSE and not known:
            good.append((cost, a))
    return good


def _of_as_many_cameras(good: list[tuple[float, Attribution]]) -> list[Attribution]:
    """Return the explanations that move as many cameras as the most likely one."""
    return [a for _, a in good if len(a.moved) == len(good[0][1].moved)]


def _with_rivals(chosen: Attribution, good: list[tuple[float, Attribution]]) -> Attribution:
    """Return an explanation with the cameras that may have moved instead, and with the spread of all `good`."""
    others = {camera for a in _of_as_many_cameras(good) for camera in a.moved} - {*chosen.moved}
    # The displacements do not show which camera moved: explanations that move as many cameras are equally good.
    as_many = [len(a.moved) == len(good[0][1].moved) for _, a in good]
    odds = np.where(as_many, 1.0, np.exp([good[0][0] - cost for cost, _ in good]))
    apart = np.array([a.displacement_px.ravel() - chosen.displacement_px.ravel() for _, a in good])
    spread = np.asarray((apart * (odds / odds.sum())[:, None]).T @ apart, dtype=np.float64)
    return Attribution(chosen.displacement_px, chosen.covariance, tuple(sorted(others)), spread)


def spread_of_unseen_motion(
    information: Floats, vector: Floats, displacement_px: Floats, weight: Floats, unmoved_px: Floats
) -> Floats:
    """Return the mean square error of estimated displacements, beyond the curvature at the estimate.

    The estimate is the maximum of the probability, under a prior that is wide near its peak and has heavy tails. The
    error follows from where cameras are: nearly all exactly where they were calibrated, a few pushed. For the first the
    curvature is too wide. For a camera that hardly any link compares with its neighbours it is too narrow, since that
    camera may have been pushed by an amount that no link would show. So each of x, y and turn of a camera is a mixture
    of two normal distributions here, not pushed and pushed, between which the links decide, while all others keep their
    priors. One by one, because a camera may move along one of them alone: that the links show no motion along the
    other two is no evidence against it.

    Args:
        information: (3n, 3n) px⁻², normal matrix of the displacements, without their prior.
        vector: (3n,) px⁻¹, its right-hand side.
        displacement_px: (n, 3) the estimated displacements.
        weight: (n,) px⁻², weights of the prior at these (`prior_weights`).
        unmoved_px: (n,) standard deviation of x, y and turn of each camera if it was not pushed.

    Returns:
        (3n, 3n) px², to be added to the covariance of the displacements. It may have negative eigenvalues.
    """
    n = len(displacement_px)
    weights, unmoved = np.repeat(weight, PARAMETERS), np.repeat(unmoved_px**2, PARAMETERS)
    whole = information + np.diag(weights)
    curvature = np.linalg.inv(whole)
    # A camera that is estimated as moved keeps the width that the prior of the estimate has there.
    actual = unmoved + np.repeat((displacement_px**2).sum(1), PARAMETERS) / (1 + PARAMETERS)
    spread = np.asarray(curvature * (weights**2 * (actual - 1 / weights)) @ curvature, dtype=np.float64)
    share = np.array([1 - _PUSHED_SHARE, _PUSHED_SHARE])
    blind = np.repeat(np.diag(information)[1::PARAMETERS] < _BLIND_PX**-2, PARAMETERS)
    pushed_px = np.where(blind, _PUSHED_BLIND_PX, _PUSHED_PX)
    for k, estimate in enumerate(displacement_px.ravel()):
        rest = np.delete(np.arange(PARAMETERS * n), k)
        follow = information[k, rest] @ np.linalg.inv(whole[np.ix_(rest, rest)])
        alone = float(information[k, k] - follow @ information[rest, k])
        right = float(vector[k] - follow @ vector[rest])
        width = unmoved[k] + np.array([0.0, pushed_px[k] ** 2])
        variance = 1 / (alone + 1 / width)
        evidence = variance * right**2 - np.log1p(alone * width)
        likely = share * np.exp((evidence - evidence.max()) / 2)
        still, pushed = (variance + (variance * right - estimate) ** 2).tolist()
        spread[k, k] += max(pushed - still, 0.0) * float(likely[1] / likely.sum())
    return spread


def prior_weights(displacement_px: Floats, still_px: float | Floats) -> Floats:
    """Return the weight (n,) px⁻² of the prior of each camera, at displacements (n, 3).

    The prior is a t distribution. A normal distribution with this weight has the same gradient at the displacements.
    """
    return np.asarray((1 + PARAMETERS) / (still_px**2 + (displacement_px**2).sum(1)))


def most_likely(
    information: Floats, vector: Floats, weight: Floats, still_px: float | Floats, iterations: int
) -> tuple[Floats, Floats]:
    """Find a local maximum of the probability of displacements by iterative reweighting (EM).

    Args:
        information: (3n, 3n) px⁻², normal matrix without the prior.
        vector: (3n,) px⁻¹, its right-hand side.
        weight: (n,) px⁻², weights of the prior with which the search starts.
        still_px: standard deviation of the displacement of a camera that was not moved, for all or for each (n,).
        iterations: number of iterations.

    Returns:
        The displacements (n, 3), and the weights (n,) of the prior with which they were computed.
    """
    for left in range(iterations - 1, -1, -1):
        whole = information + np.diag(np.repeat(weight, PARAMETERS))
        d = np.asarray(np.linalg.solve(whole, vector), dtype=np.float64).reshape(-1, PARAMETERS)
        if left:
            weight = prior_weights(d, still_px)
    return d, weight


def _maximum(
    information: Floats, vector: Floats, weight: Floats, still_px: float | Floats
) -> tuple[float, Attribution]:
    """Find one local maximum of the probability from an initial weight (n,) of each camera's prior.

    Return the negative log-probability of the maximum, up to a constant, and the displacements there.
    """
    d, _ = most_likely(information, vector, weight, still_px, _ITERATIONS)
    x, moved = d.ravel(), (d**2).sum(1)
    cost = float(x @ information @ x / 2 - x @ vector) + (1 + PARAMETERS) / 2 * float(
        np.log1p(moved / still_px**2).sum()
    )
    prior = np.diag(np.repeat(prior_weights(d, still_px), PARAMETERS))
    covariance = np.asarray(np.linalg.inv(information + prior), dtype=np.float64)
    return cost, Attribution(d, covariance)

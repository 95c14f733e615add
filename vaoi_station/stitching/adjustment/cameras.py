"""Displacements of cameras against their calibration, as unknowns of the adjustment, and their prior.

A camera whose picture moved by a displacement (x, y, turn), in px (`geometry.displacement`), sees every ground point
moved by a small rotation and shift of the calibrated plane. Within one pair of frames, this has the same effect as a
change of the row's motion: with m the middle of the camera's view, a rotation by θ about m and a shift t are, in row j,

    δφ_j = θ,    δs_j = R(φ_j)·(t − θ·J(m − c)),    J = rotation by 90°.

The equations of a displacement are therefore linear combinations of the equations of rows, computed from sums over the
links of a pair of frames.

Links between neighbouring cameras show how these cameras moved against one another. They do not show a motion of the
whole array; a stretch of the array along the row of cameras looks to them like boards that lie higher. A camera is
either where it was calibrated, to a few hundredths of a pixel, or it was moved by an unknown amount: its prior is
Student's t distribution with one degree of freedom. Of all displacements that explain the links, those in which most
cameras have not moved are then the most likely.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import PARAMETERS, CameraMatrices, displaced_cameras, move_points
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import NormalEquations, solve_forward
from vaoi_station.stitching.adjustment.equations import LinkState
from vaoi_station.stitching.adjustment.problem import CameraEstimate, Ints, Problem

STILL_PX = 0.03  # standard deviation, over many runs, of x, y and turn of a camera that was not moved
MOVED_PX = 2 * STILL_PX  # length of the displacement vector (x, y, turn) above which a camera counts as moved
_WIDE_PX, _ITERATIONS = 100.0, 40
_SAME_PX = 0.01  # two explanations whose displacements differ by at most this are the same one
_CLOSE = 10.0
"""Difference of log-probability up to which two explanations count as equally good.

Such explanations can name different cameras. Only keystone distortion could decide between them. A camera shows it
after a turn, but not after a shift."""
_PUSHED_SHARE, _PUSHED_PX = 0.07, 0.1
"""Share of cameras that were pushed along x (or along y, or turned), and standard deviation of such a displacement.

Together they are 0.03 px rms, as `STILL_PX`. With a smaller share or width, errors under pushed cameras would be too
long in units of σ; with larger ones, σ under cameras that have not moved would be too large
(docs/explanation/uncertainty.md)."""
_BLIND_PX, _PUSHED_BLIND_PX = 0.2, 0.35
"""Standard deviation, px, above which links do not show where a camera lies across its neighbours' seams, and the width
of a push that they then would not show.

Along the row of cameras a board that is lifted explains any push. Across it, only a blank overlap hides one: then a
camera may have been pushed further than what an overlap would have shown on earlier boards (seed 106038)."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """The most likely displacements of n cameras, their covariance, and the cameras that may have moved instead."""

    displacement_px: Floats  # (n, 3) displacement x, y and turn of each camera
    covariance: Floats  # (3n, 3n) covariance of the displacements, px², camera by camera
    rivals: tuple[int, ...] = ()  # cameras that have moved in another, equally good explanation, but not in this one
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


def attribute_motion(
    information: Floats, vector: Floats, still_px: float | Floats = STILL_PX, *, same_for_all_runs: bool = True
) -> Attribution:
    """Find which of n cameras were displaced, and how far; different cameras can explain the same links.

    Args:
        information: (3n, 3n) px⁻², normal matrix of the displacements, without their prior.
        vector: (3n,) px⁻¹, right-hand side of the same normal equations.
        still_px: standard deviation of the displacement of a camera that was not moved, for all or for each (n,).
        same_for_all_runs: whether to return, of equally probable explanations, the one with the lowest camera numbers,
            so that every run names the same camera, instead of the most probable one.
    """
    # The probability has several maxima, so one search starts from each camera as the only fixed one, and one from each
    # camera as the only moved one.
    n = len(vector) // PARAMETERS
    own, tight, wide = np.eye(n, dtype=np.bool_), 1 / np.broadcast_to(still_px, n) ** 2, 1 / _WIDE_PX**2
    starts = [*np.where(own, tight, wide), *np.where(own, wide, tight)]
    found = sorted((_maximum(information, vector, weight, still_px) for weight in starts), key=lambda f: f[0])
    good: list[tuple[float, Attribution]] = []
    for cost, a in found:
        known = any(np.abs(a.displacement_px - other.displacement_px).max() < _SAME_PX for _, other in good)
        if cost < found[0][0] + _CLOSE and not known:
            good.append((cost, a))
    least, chosen = good[0]
    # The displacements do not show which camera moved: explanations that move as many cameras are equally good.
    as_many = [len(a.moved) == len(chosen.moved) for _, a in good]
    alike = [a for (_, a), same in zip(good, as_many, strict=True) if same]
    if same_for_all_runs and chosen.moved:
        chosen = min(alike, key=lambda a: a.moved)
    others = {camera for a in alike for camera in a.moved} - {*chosen.moved}
    odds = np.where(as_many, 1.0, np.exp([least - cost for cost, _ in good]))
    apart = np.array([a.displacement_px.ravel() - chosen.displacement_px.ravel() for _, a in good])
    spread = np.asarray((apart * (odds / odds.sum())[:, None]).T @ apart, dtype=np.float64)
    return replace(chosen, rivals=tuple(sorted(others)), spread=spread)


def _maximum(
    information: Floats, vector: Floats, weight: Floats, still_px: float | Floats
) -> tuple[float, Attribution]:
    """Find one local maximum of the probability from an initial weight (n,) of each camera's prior.

    Return the negative log-probability of the maximum, up to a constant, and the displacements there.
    """
    d, _ = most_likely(information, vector, weight, still_px, _ITERATIONS)
    x, tails = d.ravel(), np.log1p((d**2).sum(1) / still_px**2)
    cost = float(x @ information @ x / 2 - x @ vector) + (1 + PARAMETERS) / 2 * float(tails.sum())
    whole = with_prior(information, np.repeat(prior_weights(d, still_px), PARAMETERS))
    return cost, Attribution(d, np.asarray(np.linalg.inv(whole), dtype=np.float64))


def with_prior(information: Floats, weight: Floats) -> Floats:
    """Return a normal matrix (n, n) with weights (n,) added to its diagonal."""
    whole = information.copy()
    whole.flat[:: len(weight) + 1] += weight
    return whole


def most_likely(
    information: Floats, vector: Floats, weight: Floats, still_px: float | Floats, iterations: int
) -> tuple[Floats, Floats]:
    """Find a local maximum of the probability by iterative reweighting (EM), for the arguments of `attribute_motion`.

    `weight` (n,) px⁻² are the weights of the prior with which the search starts. Return the displacements (n, 3), and
    the weights with which they were computed.
    """
    for left in range(iterations - 1, -1, -1):
        whole = with_prior(information, np.repeat(weight, PARAMETERS))
        d = np.asarray(np.linalg.solve(whole, vector), dtype=np.float64).reshape(-1, PARAMETERS)
        if left:
            weight = prior_weights(d, still_px)
    return d, weight


def prior_weights(displacement_px: Floats, still_px: float | Floats) -> Floats:
    """Return the weight (n,) px⁻² of the prior of each camera, at displacements (n, 3).

    The prior is a t distribution. A normal distribution with this weight has the same gradient at the displacements.
    """
    return np.asarray((1 + PARAMETERS) / (still_px**2 + (displacement_px**2).sum(1)))


def spread_of_unseen_motion(
    information: Floats, vector: Floats, displacement_px: Floats, weight: Floats, unmoved_px: Floats
) -> Floats:
    """Return the mean square error (3n, 3n) px² of estimated displacements, beyond the curvature at the estimate.

    The estimate is the maximum of the probability, under a prior that is wide near its peak and has heavy tails. The
    error follows from where cameras are: nearly all exactly where they were calibrated, a few pushed. For the first the
    curvature is too wide. For a camera that hardly any link compares with its neighbours it is too narrow, since that
    camera may have been pushed by an amount that no link would show. So each of x, y and turn of a camera is a mixture
    of two normal distributions here, not pushed and pushed, between which the links decide, while all others keep their
    priors. One by one, because a camera may move along one of them alone: that the links show no motion along the
    other two is no evidence against it. The result may have negative eigenvalues.

    Args:
        information: (3n, 3n) px⁻², normal matrix of the displacements, without their prior.
        vector: (3n,) px⁻¹, its right-hand side.
        displacement_px: (n, 3) the estimated displacements.
        weight: (n,) px⁻², weights of the prior at these (`prior_weights`).
        unmoved_px: (n,) standard deviation of x, y and turn of each camera if it was not pushed.
    """
    weights, unmoved = np.repeat(weight, PARAMETERS), np.repeat(unmoved_px**2, PARAMETERS)
    curvature = np.linalg.inv(with_prior(information, weights))
    # A camera that is estimated as moved keeps the width that the prior of the estimate has there.
    estimate = displacement_px.ravel()
    actual = unmoved + np.repeat((displacement_px**2).sum(1), PARAMETERS) / (1 + PARAMETERS)
    spread = np.asarray(curvature * (weights**2 * (actual - 1 / weights)) @ curvature, dtype=np.float64)
    blind = np.repeat(np.diag(information)[1::PARAMETERS] < _BLIND_PX**-2, PARAMETERS)
    # Information and vector of each number alone, after all others are eliminated with their priors.
    alone = np.maximum(1 / np.diag(curvature) - weights, 0.0)
    right = curvature @ vector / np.diag(curvature)
    # In two lines, not pushed and pushed.
    width = unmoved + np.where(blind, _PUSHED_BLIND_PX, _PUSHED_PX) ** 2 * np.array([[0.0], [1.0]])
    variance = 1 / (alone + 1 / width)
    evidence = variance * right**2 - np.log1p(alone * width)
    likely = np.array([[1 - _PUSHED_SHARE], [_PUSHED_SHARE]]) * np.exp((evidence - evidence.max(0)) / 2)
    still, pushed = variance + (variance * right - estimate) ** 2
    spread[np.diag_indices_from(spread)] += np.maximum(pushed - still, 0.0) * likely[1] / likely.sum(0)
    return spread


_STEP_PX = 0.05  # step of the numeric derivatives by a displacement; the functions are smooth over hundreds of px
_STILL_PX, _UNMOVED_PX = 0.006, 0.001
"""Scale of the prior of the estimate, and standard deviation of x, y and turn of a camera that was not pushed.

A camera that was not pushed moves less within one run than the estimate lets it. What links between two cameras have in
common looks like a displacement: where exposures differ by 17 : 1, positions are worse by a quarter if the estimate is
as narrow."""
_FIRST_STILL_PX, _TIGHTENING = 0.5, 4.0
"""The first step uses `_FIRST_STILL_PX` in place of `_STILL_PX`; each further step divides it by `_TIGHTENING`.

With the tight prior from the start, the search would stay at displacements of 0, which is a local maximum."""
_ANYWHERE_PX = 1000.0  # σ of the weak prior that makes the normal matrix regular, before the real one replaces it
_EM_ITERATIONS = 5  # iterations of the search for the most likely displacements in each step of the adjustment
_LARGE_PX = 1.0  # beyond this displacement, the first steps try each camera as the only one that moved
_NEW_EFFECTS_PX = 0.5  # the effects, which vary slowly, are computed again after a displacement has changed by this
_OTHER_PX = 0.02  # another explanation is tried only if one of its displacements differs by more than this


class CameraEffects(NamedTuple):
    """The effect of small displacements of n cameras on the ground points that they see."""

    motion: Floats  # (n, 3, 3) change of (θ, tx, ty), in rad and mm, per px of x, y and turn
    middle_mm: Floats  # (n, 2) middle of each camera's view, about which the ground points are rotated

    @staticmethod
    def of(cameras: CameraMatrices, displacement_px: Floats) -> CameraEffects:
        """Return the effects of changes of the displacements (n, 3) with which the cameras are taken."""
        # the cameras as they are, and with each of the three numbers changed
        steps = np.concatenate([np.zeros((1, PARAMETERS)), _STEP_PX * np.eye(PARAMETERS)])
        h = cameras.row_from_image @ np.linalg.inv(cameras.moved(displacement_px + steps[:, None]))
        # three points of the picture: its middle, and one to each side, from whose motion the rotation follows
        c, aside = cameras.center_px, cameras.center_px * (1, 0)
        q = h[..., :2] @ np.stack([c, c + aside, c - aside], -1) + h[..., 2:]
        ground = q[..., :2, :] / q[..., 2:, :]
        middle, arm = ground[0, :, :, 0], ground[0, :, :, 1] - ground[0, :, :, 2]
        change = (ground[1:] - ground[0]) / _STEP_PX
        turned = change[..., 1] - change[..., 2]
        theta = (arm[:, 0] * turned[..., 1] - arm[:, 1] * turned[..., 0]) / (arm**2).sum(1)
        motion = np.array([theta, change[:, :, 0, 0], change[:, :, 1, 0]])
        return CameraEffects(np.ascontiguousarray(np.moveaxis(motion, 2, 0)), middle)

    def row_changes(self, angle: Floats, pivot: Floats) -> Floats:
        """Return the changes of (φ, sx, sy) of m rows that have the effect of a displacement of a camera.

        (n, m, 3, 3) for each camera and row, per px of x, y and turn, for rows at angles (m,) about a pivot (2,).
        """
        theta, tx, ty = np.moveaxis(self.motion, 1, 0)
        x, y = (self.middle_mm - pivot).T[:, :, None]
        tx, ty = (tx + theta * y)[:, None], (ty - theta * x)[:, None]
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        sx = cos * tx - sin * ty
        return np.stack([np.broadcast_to(theta[:, None], sx.shape), sx, sin * tx + cos * ty], 2)

    def rotation_of_all(self) -> Floats:
        """Return the displacements (3n,) px of the cameras by which the whole array is rotated by 1 rad."""
        x, y = self.middle_mm.T
        turn = np.stack([np.ones_like(x), -y, x], -1)
        return np.asarray(np.linalg.solve(self.motion, turn[:, :, None]).ravel())


def comparable_cameras(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """Return the cameras whose displacements a run can show: all of an array, none if there is only one camera.

    A single camera has no neighbour to compare it with. Its displacement would only follow the priors of the belt.
    """
    return cameras if len(cameras) > 1 else ()


def without_direction(information: Floats, vector: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Return normal equations (n, n), (n,) from which all information about a motion along a direction (n,) is removed.

    Links do not show a rotation of the whole array. At large displacements, nonlinear effects and the prior of the belt
    seem to show one. The displacement of one camera would then be attributed to all other cameras.
    """
    effect = information @ direction
    strength = float(direction @ effect)
    if strength <= 0:
        return information, vector
    remaining = information - np.outer(effect, effect) / strength
    return remaining, vector - effect * (float(direction @ vector) / strength)


class MovingCameras:
    """The displacements of a problem's cameras as unknowns: their current values, prior, and effect on observations.

    If the problem has no cameras, it has no such unknowns, and observations are those of the calibrated cameras.
    """

    def __init__(self, problem: Problem, first_column: int) -> None:
        """Start with displacements of 0. Their columns begin at `first_column` of the normal equations."""
        self.calibrated = problem.cameras
        self.displacement_px = np.zeros((len(problem.cameras), PARAMETERS))
        self.unknowns = self.displacement_px.size
        self.first_column = first_column if self.unknowns else -1
        self._matrices = CameraMatrices.of(problem.cameras)
        # Homographies from ground points by the calibrated cameras to those with their current displacements, and the
        # detections as these see them.
        self.changes = np.tile(np.eye(3), (len(problem.cameras), 1, 1))
        self.points = problem.fiducials
        self._problem = problem
        self._use_effects()
        # Where the calibration states its covariance, the errors of shift and turn are added.
        errors = [np.zeros(1) if c.covariance_px2 is None else np.diag(c.covariance_px2) for c in self.calibrated]
        stated_px = np.sqrt(np.array([variance[:PARAMETERS].max() for variance in errors]))
        self._final_px: Floats = np.hypot(_STILL_PX, stated_px)
        self._still_px = np.maximum(_FIRST_STILL_PX, self._final_px)
        self._unmoved_px: Floats = np.hypot(_UNMOVED_PX, stated_px)
        self._weight: Floats | None = None
        self._information, self._vector = np.zeros((self.unknowns,) * 2), np.zeros(self.unknowns)
        # The entries of the displacements' lower triangle, as lines and columns, and where equations store them.
        self._stored: tuple[tuple[Ints, Ints], Ints] | None = None
        self._rivals: tuple[int, ...] = ()
        self._spread: Floats | None = None
        self._considered = not self.unknowns

    def _use_effects(self) -> None:
        self.effects, self._effects_at = CameraEffects.of(self._matrices, self.displacement_px), self.displacement_px
        self._rotation = self.effects.rotation_of_all() if self.unknowns else np.zeros(0)

    def begin_at(self, displacement_px: Floats) -> None:
        """Take over displacements (n, 3) that an adjustment of fewer rows has found, and its prior."""
        self._still_px = self._final_px
        if self.unknowns:
            self.displacement_px = displacement_px
            self._use_effects()
            self.move(np.zeros(self.unknowns))

    @property
    def settled(self) -> bool:
        """Whether the prior had its final width in the last step."""
        return bool((self._still_px <= self._final_px).all())

    def regularise(self, normal: NormalEquations) -> None:
        """Add a weak prior to the normal equations, without which a camera that no link shows would be singular.

        `constrain` replaces it by the real prior.
        """
        own = np.arange(len(normal.first) - self.unknowns, len(normal.first))
        normal.values[normal.at[own] + own] += 1 / _ANYWHERE_PX**2

    def constrain(self, normal: NormalEquations) -> Floats:
        """Add the prior of the displacements to factorised normal equations; return the vector of `solve_forward`.

        The displacements stand last. The trailing block of the factor therefore is the factor of their reduced normal
        matrix, from which all other unknowns are eliminated. The prior is added there.
        """
        forward = solve_forward(normal)
        if not self.unknowns:
            return forward
        if self._stored is None:
            self._stored = (
                np.tril_indices(self.unknowns),
                normal.trailing(self.unknowns)[np.tril_indices(self.unknowns)],
            )
        (stored, at), lower = self._stored, np.zeros((self.unknowns, self.unknowns))
        lower[stored] = normal.values[at]
        reduced = lower @ forward[-self.unknowns :]
        information = lower @ lower.T
        information.flat[:: self.unknowns + 1] -= 1 / _ANYWHERE_PX**2
        d = self.displacement_px.ravel()
        self._information, reduced = without_direction(information, reduced, self._rotation)
        self._vector = reduced + self._information @ d
        start = prior_weights(self.displacement_px, self._still_px) if self._weight is None else self._weight
        found, weight = most_likely(self._information, self._vector, start, self._still_px, _EM_ITERATIONS)
        if not self.settled and np.abs(found).max() > _LARGE_PX:
            # Otherwise, one large displacement becomes a rotation of the whole array, which links do not show. The true
            # displacements are then too far away for linear equations.
            weight = prior_weights(self._attribution(self._still_px).displacement_px, self._still_px)
        prior = np.repeat(weight, PARAMETERS)
        lower = np.asarray(np.linalg.cholesky(with_prior(self._information, prior)), dtype=np.float64)
        normal.values[at] = lower[stored]
        forward[-self.unknowns :] = np.linalg.solve(lower, reduced - prior * d)
        self._weight = None
        self._still_px = np.maximum(self._still_px / _TIGHTENING, self._final_px)
        return forward

    def _attribution(self, still_px: Floats) -> Attribution:
        return attribute_motion(self._information, self._vector, still_px, same_for_all_runs=False)

    def move(self, delta: Floats) -> None:
        """Change the displacements by the solution (n,) of a step, and all observations with them."""
        if not self.unknowns:
            return
        change = delta[-self.unknowns :].reshape(-1, PARAMETERS)
        self.displacement_px = self.displacement_px + change
        if np.abs(self.displacement_px - self._effects_at).max() > _NEW_EFFECTS_PX:
            self._use_effects()
        self.changes, points = self._matrices.ground_changes(self.displacement_px), self._problem.fiducials
        if points is not None:
            self.points = replace(points, ground_mm=move_points(points.ground_mm, points.camera, self.changes))

    def displaced_problem(self, state: LinkState) -> Problem:
        """Return the problem with observations and cameras as they are with the current displacements."""
        if not self.unknowns:
            return self._problem
        links = replace(self._problem.links, a_mm=state.a_mm, b_mm=state.b_mm)
        cameras = displaced_cameras(self.calibrated, self.displacement_px)
        return replace(self._problem, links=links, fiducials=self.points, cameras=cameras)

    def reconsider(self) -> bool:
        """Search once whether other displacements explain the links better; return True if more steps are needed.

        The search is made only if a camera is displaced. The next step starts from the explanation found.
        """
        if self._considered:
            return False
        self._considered = True
        if np.hypot.reduce(self.displacement_px, axis=1).max() <= MOVED_PX:
            return False
        found = self._attribution(self._final_px)
        self._rivals, self._spread = found.rivals, found.spread
        if np.abs(found.displacement_px - self.displacement_px).max() <= _OTHER_PX:
            return False
        self._weight = prior_weights(found.displacement_px, self._final_px)
        return True

    def widen(self, covariance: Floats, others: int) -> Floats:
        """Return the covariance with the spread of other good explanations of the displacements.

        If two explanations fit equally well, positions are as uncertain as their difference. Cameras that were not
        pushed vary less than the prior of the estimate lets them; where hardly a link shows a camera, it may have been
        pushed unseen. All other unknowns follow the displacements linearly.

        Args:
            covariance: (m, v, v) for each row, covariance of its unknowns, the shared ones, and the displacements.
            others: number u of unknowns before the displacements.
        """
        # Before the first step there is no information.
        if not self.unknowns or not self._information.any():
            return covariance
        weight = prior_weights(self.displacement_px, self._final_px)
        spread = spread_of_unseen_motion(
            self._information, self._vector, self.displacement_px, weight, self._unmoved_px
        )
        if self._spread is not None:
            spread = spread + self._spread
        follow = covariance[:, :, others:] @ np.linalg.inv(covariance[0, others:, others:])
        return np.asarray(covariance + follow @ spread @ follow.swapaxes(1, 2))

    def estimate(self, covariance: Floats, others: int) -> CameraEstimate | None:
        """Return the estimate of the displacements, for the arguments of `widen`; None if the cameras are exact."""
        if not self.unknowns:
            return None
        own, cross = covariance[0, others:, others:].copy(), covariance[:, :others, others:].copy()
        return CameraEstimate(self.displacement_px, own, cross, self._information, self._vector, self._rivals)

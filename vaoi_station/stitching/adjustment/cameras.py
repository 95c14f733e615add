"""Equations of the displacements of cameras against their calibration, as unknowns of the adjustment.

A camera whose picture moved by a displacement (x, y, turn), in px (`geometry.displacement`), sees every ground point
moved by a small rotation and shift of the calibrated plane. Within one pair of frames, this has the same effect as a
change of the row's motion: with m the middle of the camera's view, a rotation by θ about m and a shift t are, in row j,

    δφ_j = θ,    δs_j = R(φ_j)·(t − θ·J(m − c)),    J = rotation by 90°.

The equations of a camera's displacement are therefore linear combinations of the equations of its rows. They are
computed from sums over the links of a pair of frames, not from single links.

The prior of the cameras' displacements, and the attribution of motion to as few cameras as possible.

Links between neighbouring cameras show how these cameras moved against one another. Links do not show a motion of the
whole array. A stretch of the array along the row of cameras looks to them like boards that lie higher. A camera is
either where it was calibrated, to a few hundredths of a pixel, or it was moved by an unknown amount. This knowledge is
a prior with heavy tails for each camera: Student's t distribution with one degree of freedom. Under this prior, of all
displacements that explain the links, those in which most cameras have not moved are the most likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import PARAMETERS, displace_camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import Envelope, NormalEquations, solve_forward, trailing_lines
from vaoi_station.stitching.adjustment.problem import (
    CameraEstimate,
    CameraPairs,
    FiducialPoints,
    Ints,
    LinkArrays,
    Problem,
)

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


_STEP_PX = 0.05
"""Step of the numeric derivatives with respect to a displacement; the functions are smooth over hundreds of px."""
_STILL_PX, _UNMOVED_PX = 0.006, 0.001
"""Scale of the prior of the estimate, and standard deviation of x, y and turn of a camera that was not pushed.

A camera that was not pushed moves less within one run than the estimate lets it. What links between two cameras have in
common looks like a displacement: where exposures differ by 17 : 1, positions are worse by a quarter if the estimate is
as narrow."""
_FIRST_STILL_PX, _TIGHTENING = 0.5, 4.0
"""The first step uses `_FIRST_STILL_PX` in place of `_STILL_PX`; each further step divides it by `_TIGHTENING`.

With the tight prior from the start, the search would stay at displacements of 0, which is a local maximum."""
_ANYWHERE_PX = 1000.0
"""Standard deviation of the weak prior that makes the normal matrix regular, before the real prior replaces it."""
_EM_ITERATIONS = 5
"""Iterations of the search for the most likely displacements in each step of the adjustment."""
_LARGE_PX = 1.0
"""If a displacement exceeds this, px, the first steps of the search try each camera as the only one that moved."""
_UNCHANGED_PX = 1e-7
"""If no displacement changes by more than this, px, the links are not projected again."""
_NEW_EFFECTS_PX = 0.5
"""The effects of displacements are computed again after a displacement has changed by this, px; they vary slowly."""
_OTHER_PX = 0.02
"""Another explanation of the links is tried only if one of its displacements differs by more than this, px."""


class CameraEffects(NamedTuple):
    """The effect of small displacements of n cameras on the ground points that they see."""

    motion: Floats
    """(n, 3, 3) change of (θ, tx, ty), in rad and mm, per px of x, y and turn."""
    middle_mm: Floats
    """(n, 2) middle of each camera's view, about which the ground points are rotated."""


def camera_effects(cameras: Sequence[Camera], displacement_px: Floats) -> CameraEffects:
    """Return how small changes of the displacements of cameras move the ground points that the cameras see.

    The changes are counted from the displacements `displacement_px` (n, 3), with which the cameras are taken.
    """
    motion, middle = np.zeros((len(cameras), 3, 3)), np.zeros((len(cameras), 2))
    for i, camera in enumerate(cameras):
        here = displace_camera(camera, displacement_px[i])
        c = np.array(camera.center_px)
        # three points of the picture: its middle, and one to each side, from whose motion the rotation follows
        px = np.array([c, c + (c[0], 0), c - (c[0], 0)])
        ground = here.row_from_image(px)
        middle[i], arm = ground[0], ground[1] - ground[2]
        for k, step in enumerate(np.eye(PARAMETERS) * _STEP_PX):
            moved = displace_camera(camera, displacement_px[i] + step).row_from_image(px)
            change, turned = (moved - ground) / _STEP_PX, (moved[1] - moved[2] - arm) / _STEP_PX
            motion[i, 0, k] = (arm[0] * turned[1] - arm[1] * turned[0]) / (arm @ arm)
            motion[i, 1:, k] = change[0]
    return CameraEffects(motion, middle)


def comparable_cameras(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """Return the cameras whose displacements a run can show: all of an array, none if there is only one camera.

    A single camera has no neighbour to compare it with. Its displacement would only follow the priors of the belt.
    """
    return cameras if len(cameras) > 1 else ()


def displaced_cameras(cameras: Sequence[Camera], displacement_px: Floats) -> tuple[Camera, ...]:
    """Return the cameras with the N_i that result from their displacements (n, 3)."""
    return tuple(displace_camera(camera, d) for camera, d in zip(cameras, displacement_px, strict=True))


def ground_changes(cameras: Sequence[Camera], displacement_px: Floats) -> Floats:
    """Return homographies (n, 3, 3) from ground points by the calibrated cameras to those by the displaced ones."""
    displaced = displaced_cameras(cameras, displacement_px)
    pairs = zip(displaced, cameras, strict=True)
    return np.array([now.row_from_image.matrix @ then.image_from_row.matrix for now, then in pairs])


def displaced_links(links: LinkArrays, pairs: CameraPairs, changes: Floats) -> LinkArrays:
    """Return links (k) with the ground points that displaced cameras see; `changes` are from `ground_changes`."""
    a_mm = move_points(links.a_mm, pairs.a[links.group], changes)
    return links._replace(a_mm=a_mm, b_mm=move_points(links.b_mm, pairs.b[links.group], changes))


@compiled
def move_points(ground_mm: Floats, camera: Ints, changes: Floats) -> Floats:
    """Transform ground points (k, 2) of the cameras numbered `camera` (k,) by homographies (n, 3, 3)."""
    out = np.empty_like(ground_mm)
    for k in range(len(ground_mm)):
        h, x, y = changes[camera[k]], ground_mm[k, 0], ground_mm[k, 1]
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        out[k, 0] = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        out[k, 1] = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
    return out


@inlined
def row_change(cameras: CameraEffects, i: int, cos: float, sin: float, pivot: Floats, out: Floats) -> None:
    """Compute the change of a row that has the effect of a displacement of camera i.

    Args:
        cameras: effects of displacements.
        i: number of the camera.
        cos: cosine of the row's angle φ.
        sin: sine of the row's angle φ.
        pivot: (2,) point c about which the rows are rotated.
        out: (3, 3) changes of (φ, sx, sy) per px of x, y and turn, overwritten.
    """
    motion = cameras.motion[i]
    x, y = cameras.middle_mm[i, 0] - pivot[0], cameras.middle_mm[i, 1] - pivot[1]
    for k in range(3):
        tx, ty = motion[1, k] + motion[0, k] * y, motion[2, k] - motion[0, k] * x
        out[0, k], out[1, k], out[2, k] = motion[0, k], cos * tx - sin * ty, sin * tx + cos * ty


@compiled
def row_changes(cameras: CameraEffects, camera: Ints, angle: Floats, pivot: Floats) -> Floats:
    """Return the changes (k, 3, 3) of k rows that have the effect of a displacement of a camera; see `row_change`.

    The cameras are numbered `camera` (k,); the rows have angles (k,), rad.
    """
    out = np.empty((len(camera), 3, 3))
    for k in range(len(camera)):
        row_change(cameras, camera[k], np.cos(angle[k]), np.sin(angle[k]), pivot, out[k])
    return out


def rotation_of_all(cameras: CameraEffects) -> Floats:
    """Return the displacements (3n,) of n cameras in px by which the whole array is rotated by 1 rad."""
    steps = [
        np.linalg.solve(motion, (1.0, -y, x)) for motion, (x, y) in zip(cameras.motion, cameras.middle_mm, strict=True)
    ]
    return np.concatenate(steps)


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


def _still_px(cameras: Sequence[Camera]) -> Floats:
    """Return the standard deviation (n,) of each camera's displacement if it was not moved, px.

    It is at least `_STILL_PX`. Where the calibration states its covariance, the errors of shift and turn are added.
    """
    return np.asarray(np.hypot(_STILL_PX, _stated_px(cameras)))


def _stated_px(cameras: Sequence[Camera]) -> Floats:
    """Return the largest standard deviation (n,) of shift and turn that each camera's calibration states, px."""
    stated = [0.0 if c.covariance_px2 is None else float(np.diag(c.covariance_px2)[:PARAMETERS].max()) for c in cameras]
    return np.asarray(np.sqrt(np.array(stated)))


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
        self.links = problem.links.arrays
        """Links as the cameras see them with their current displacements."""
        self.points: FiducialPoints | None = problem.fiducials
        """Detections as the cameras see them with their current displacements."""
        self.effects = camera_effects(self.calibrated, self.displacement_px)
        self._problem = problem
        self._effects_at = self.displacement_px
        self._final_px = _still_px(self.calibrated)
        self._still_px = np.maximum(_FIRST_STILL_PX, self._final_px)
        self._unmoved_px: Floats = np.hypot(_UNMOVED_PX, _stated_px(self.calibrated))
        self._weight: Floats | None = None
        self._information, self._vector = np.zeros((self.unknowns,) * 2), np.zeros(self.unknowns)
        self._rivals: tuple[int, ...] = ()
        self._spread: Floats | None = None
        self._considered = not self.unknowns

    @property
    def settled(self) -> bool:
        """Whether the prior had its final width in the last step."""
        return bool((self._still_px <= self._final_px).all())

    def columns_of(self, camera: Ints) -> Ints:
        """Return the columns (k, 3) of the displacements of cameras numbered `camera` (k,)."""
        return np.asarray(self.first_column + PARAMETERS * camera[:, None] + np.arange(PARAMETERS))

    def regularise(self, envelope: Envelope, normal: NormalEquations) -> None:
        """Add a weak prior to the normal equations, without which a camera that no link shows would be singular.

        `constrain` replaces it by the real prior.
        """
        own = np.arange(envelope.size - self.unknowns, envelope.size)
        normal.values[envelope.at[own] + own] += 1 / _ANYWHERE_PX**2

    def constrain(self, envelope: Envelope, normal: NormalEquations) -> Floats:
        """Add the prior of the displacements to factorised normal equations; return the vector of `solve_forward`.

        The displacements stand last. The trailing block of the factor therefore is the factor of their reduced normal
        matrix, from which all other unknowns are eliminated. The prior is added there.
        """
        forward = solve_forward(normal)
        if not self.unknowns:
            return forward
        at = trailing_lines(envelope, self.unknowns)
        lower: Floats = np.tril(normal.values[at])
        self._information, reduced = lower @ lower.T, lower @ forward[-self.unknowns :]
        self._information -= np.eye(self.unknowns) / _ANYWHERE_PX**2
        d = self.displacement_px.ravel()
        self._information, reduced = without_direction(self._information, reduced, rotation_of_all(self.effects))
        self._vector = reduced + self._information @ d
        start = prior_weights(self.displacement_px, self._still_px) if self._weight is None else self._weight
        found, weight = most_likely(self._information, self._vector, start, self._still_px, _EM_ITERATIONS)
        if not self.settled and np.abs(found).max() > _LARGE_PX:
            # Otherwise, one large displacement becomes a rotation of the whole array, which links do not show. The true
            # displacements are then too far away for linear equations.
            found = most_likely_motion(self._information, self._vector, self._still_px).displacement_px
            weight = prior_weights(found, self._still_px)
        prior = np.repeat(weight, PARAMETERS)
        lower = np.asarray(np.linalg.cholesky(self._information + np.diag(prior)), dtype=np.float64)
        stored = np.tril_indices(self.unknowns)
        normal.values[at[stored]] = lower[stored]
        forward[-self.unknowns :] = np.linalg.solve(lower, reduced - prior * d)
        self._weight = None
        self._still_px = np.maximum(self._still_px / _TIGHTENING, self._final_px)
        return forward

    def move(self, delta: Floats) -> None:
        """Change the displacements by the solution (n,) of a step, and all observations with them."""
        if not self.unknowns:
            return
        change = delta[-self.unknowns :].reshape(-1, PARAMETERS)
        self.displacement_px = self.displacement_px + change
        if np.abs(change).max() < _UNCHANGED_PX:
            return
        if np.abs(self.displacement_px - self._effects_at).max() > _NEW_EFFECTS_PX:
            self.effects = camera_effects(self.calibrated, self.displacement_px)
            self._effects_at = self.displacement_px
        changes, points = ground_changes(self.calibrated, self.displacement_px), self._problem.fiducials
        self.links = displaced_links(self._problem.links.arrays, self._problem.links.pairs, changes)
        if points is not None:
            self.points = replace(points, ground_mm=move_points(points.ground_mm, points.camera, changes))

    def displaced_problem(self) -> Problem:
        """Return the problem with observations and cameras as they are with the current displacements."""
        if not self.unknowns:
            return self._problem
        links = replace(self._problem.links, a_mm=self.links.a_mm, b_mm=self.links.b_mm)
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
        found = most_likely_motion(self._information, self._vector, self._final_px)
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
        """Return the estimate of the displacements; None if the cameras are taken as exact.

        Args:
            covariance: (m, v, v) for each row, covariance of its unknowns, the shared ones, and the displacements.
            others: number u of unknowns before the displacements.
        """
        if not self.unknowns:
            return None
        return CameraEstimate(
            self.displacement_px,
            np.ascontiguousarray(covariance[0, others:, others:]),
            np.ascontiguousarray(covariance[:, :others, others:]),
            self._information,
            self._vector,
            self._rivals,
        )

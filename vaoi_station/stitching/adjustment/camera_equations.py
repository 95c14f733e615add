"""Equations of the displacements of cameras against their calibration, as unknowns of the adjustment.

A camera whose picture moved by a displacement (x, y, turn), in px (`geometry.displacement`), sees every ground point
moved by a small rotation and shift of the calibrated plane. Within one pair of frames, this has the same effect as a
change of the row's motion: with m the middle of the camera's view, a rotation by θ about m and a shift t are, in row j,

    δφ_j = θ,    δs_j = R(φ_j)·(t − θ·J(m − c)),    J = rotation by 90°.

The equations of a camera's displacement are therefore linear combinations of the equations of its rows. They are
computed from sums over the links of a pair of frames, not from single links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import PARAMETERS, displace_camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.camera_prior import (
    MOVED_PX,
    most_likely,
    most_likely_motion,
    prior_weights,
    spread_of_unseen_motion,
)
from vaoi_station.stitching.adjustment.envelope import Envelope, NormalEquations, solve_forward, trailing_lines
from vaoi_station.stitching.adjustment.observations import CameraPairs, Ints, LinkArrays
from vaoi_station.stitching.adjustment.problem import CameraEstimate, FiducialPoints, Problem

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

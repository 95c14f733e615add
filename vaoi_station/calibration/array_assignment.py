"""Choose one hypothesis about the marks per camera, with the nominal views as prior, and test it against others.

A hypothesis states which detected mark is which mark of the layout. All cameras film the same board. Its shift s and
turn φ against the design are common to them. The mounting of each camera displaces its view by m_i: offset_i = s −
φ·J·x_i + m_i, where J·x is the nominal centre x turned by 90°. A periodic layout also fits after a shift by whole
periods. If the frames do not contradict this, only the prior decides, which is the stated accuracy of
`nominal_center_mm`. If the prior does not decide either, the assignment is unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration.mark_identification import Hypothesis
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

DECISIVE = 7.0
"""An assignment counts as known if its log-likelihood exceeds that of every other by this (a factor of 1000)."""
_APART_MM = 0.5
"""Two hypotheses whose views are nearer to one another than this assign the same marks."""
_TOLERANCE_SIGMAS = 2.0
"""The stated tolerance of a nominal centre is this number of standard deviations.

Half of the variance belongs to the board, half to the mounting of the camera."""
_TURN_RAD, _ROLL_RAD = np.radians(2.0), np.radians(1.0)
"""Standard deviations of the turn of the board, and of the roll of one camera."""
_LINEAR_FROM = 3.0
_ROUNDS = 4
_SEED_RANGE = 30.0
"""A search for a better choice starts from a hypothesis only if its log-likelihood is not lower by more than this.

The difference is counted from the camera's best hypothesis."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """The hypothesis that was chosen for a camera, and its rival: the other hypothesis that comes nearest to it."""

    chosen: Hypothesis | None
    rival: Hypothesis | None = None
    advantage: float = np.inf
    """Log-likelihood of the best choice for the array minus that of the best choice with the rival, prior included."""
    seen: float = np.inf
    """The part of `advantage` that comes from the frames, without the nominal views."""

    @property
    def ambiguous(self) -> bool:
        """Whether frames and nominal views leave the assignment unknown."""
        return self.advantage < DECISIVE

    @property
    def by_nominal_view(self) -> bool:
        """Whether the frames also allow the rival, so that only the nominal views exclude it."""
        return self.seen < DECISIVE <= self.advantage

    @property
    def shift_mm(self) -> tuple[float, float]:
        """Shift of the layout, mm, that leads from the chosen hypothesis to the rival."""
        if self.chosen is None or self.rival is None:
            return 0.0, 0.0
        x, y = self.rival.offset_mm - self.chosen.offset_mm
        # Rounded as it is printed, so that no shift reads "-0.0".
        return round(float(x), 1) + 0.0, round(float(y), 1) + 0.0


def assign_array(
    options: Sequence[tuple[Hypothesis, ...]], heads: Sequence[CameraHead], tolerance_mm: float
) -> Iterator[Assignment]:
    """Choose one of the hypotheses of each camera, and test each choice against the others when it is asked for.

    `tolerance_mm` states how well `nominal_center_mm` is known for the board as it lies, as two standard deviations.
    """
    search = _Search.of(options, heads, tolerance_mm)
    choice = search.best()
    total = search.total(choice)
    return (_tested(search, i, choice, total) for i in range(len(options)))


def _tested(search: _Search, i: int, choice: NDArray[np.intp], total: float) -> Assignment:
    """Return the assignment of camera i, with the rival that comes nearest to the best choice."""
    options = search.options[i]
    if not options:
        return Assignment(None)
    chosen = options[choice[i]]
    result = Assignment(chosen)
    for k, other in enumerate(options):
        if np.hypot(*(other.offset_mm - chosen.offset_mm)) <= _APART_MM:
            continue
        forced = search.climb(choice, i, k)
        advantage = total - search.total(forced)
        if advantage < result.advantage:
            result = Assignment(chosen, other, advantage, search.scores(choice) - search.scores(forced))
    return result


@dataclass(frozen=True, eq=False)
class _Search:
    """The hypotheses of all n cameras as padded arrays (n, k), and the prior."""

    options: tuple[tuple[Hypothesis, ...], ...]
    centers: Floats
    score: Floats
    """(n, k) log-likelihood of each hypothesis by the camera's frame; −∞ where a camera has fewer hypotheses."""
    offset: Floats
    angle: Floats
    sigma_mm: float
    """Standard deviation per axis of the board's shift, and of the mounting of one camera."""

    @classmethod
    def of(cls, options: Sequence[tuple[Hypothesis, ...]], heads: Sequence[CameraHead], tolerance_mm: float) -> _Search:
        most = max((len(o) for o in options), default=0)
        score, angle = np.full((len(options), max(most, 1)), -np.inf), np.zeros((len(options), max(most, 1)))
        offset = np.zeros((*score.shape, 2))
        for i, hypotheses in enumerate(options):
            for k, h in enumerate(hypotheses):
                score[i, k], offset[i, k], angle[i, k] = h.score, h.offset_mm, h.angle_rad
        centers = np.array([h.nominal_center_mm or (0.0, 0.0) for h in heads], dtype=np.float64)
        sigma = tolerance_mm / _TOLERANCE_SIGMAS / np.sqrt(2)
        # About the middle of the array, shift and turn of the board are independent.
        return cls(tuple(options), centers - centers.mean(0), score, offset, angle, sigma)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether each camera has a hypothesis about its marks, (n,)."""
        return np.isfinite(self.score[:, 0])

    def best(self) -> NDArray[np.intp]:
        """Return the best choice of one hypothesis per camera, (n,) indices, after a search from every hypothesis."""
        first = np.argmax(self._with_prior(np.zeros(3)), axis=1)
        found = self.climb(first)
        total = self.total(found)
        worth = self.score > self.score.max(1, keepdims=True) - _SEED_RANGE
        for i, k in np.argwhere(worth & self.seen[:, None]):
            # One camera with the correct hypothesis leads all others to theirs.
            other = self.climb(np.argmax(self._with_prior(self._pose_by(int(i), int(k))), axis=1))
            if (better := self.total(other)) > total + 1e-9:
                found, total = other, better
        return found

    def climb(self, choice: NDArray[np.intp], camera: int | None = None, kept: int = 0) -> NDArray[np.intp]:
        """Improve a choice of one hypothesis per camera until no change improves it. If given, `camera` keeps `kept`.

        Then the search starts twice: with the choices of the other cameras, and with the whole board moved to fit that
        camera.
        """
        if camera is None:
            return self._climb(choice, None)
        forced = np.array(choice)
        forced[camera] = kept
        moved = np.argmax(self._with_prior(self._pose_by(camera, kept)), axis=1)
        moved[camera] = kept
        return max((self._climb(c, camera) for c in (forced, moved)), key=self.total)

    def _climb(self, choice: NDArray[np.intp], fixed: int | None) -> NDArray[np.intp]:
        for _ in range(_ROUNDS):
            better = np.argmax(self._with_prior(self._pose(choice)), axis=1)
            if fixed is not None:
                better[fixed] = choice[fixed]
            if np.array_equal(better, choice):
                break
            choice = better
        return choice

    def scores(self, choice: NDArray[np.intp]) -> float:
        """Return the log-likelihood of the frames for one chosen hypothesis per camera."""
        return float(self.score[self.seen, choice[self.seen]].sum())

    def total(self, choice: NDArray[np.intp]) -> float:
        """Return the log-likelihood of the frames and the nominal views, at the most likely pose of the board."""
        pose = self._pose(choice)
        chosen = self._with_prior(pose)[np.arange(len(choice)), choice][self.seen].sum()
        return float(chosen - (pose[:2] ** 2).sum() / (2 * self.sigma_mm**2) - pose[2] ** 2 / (2 * _TURN_RAD**2))

    def _with_prior(self, pose: Floats) -> Floats:
        """Add the prior of each hypothesis, given the pose (shift, turn) of the board, to its score (n, k)."""
        rest = self.offset - pose[:2] + pose[2] * self._turned()[:, None]
        far = np.hypot(rest[..., 0], rest[..., 1]) / self.sigma_mm
        roll = (self.angle - pose[2]) / _ROLL_RAD
        # Linear beyond three standard deviations: a view far from its design is unlikely, but possible.
        cost = np.where(far <= _LINEAR_FROM, far**2 / 2, _LINEAR_FROM * (far - _LINEAR_FROM / 2))
        return np.asarray(self.score - cost - roll**2 / 2)

    def _turned(self) -> Floats:
        """Compute J·x: the nominal centres (n, 2), turned by 90°."""
        return np.column_stack([-self.centers[:, 1], self.centers[:, 0]])

    def _pose_by(self, camera: int, k: int) -> Floats:
        """Return the pose (3,) with which one camera sees hypothesis k exactly in its nominal view."""
        turn = self.angle[camera, k]
        return np.append(self.offset[camera, k] + turn * self._turned()[camera], turn)

    def _pose(self, choice: NDArray[np.intp]) -> Floats:
        """Estimate shift and turn (3,) of the board from the chosen hypotheses."""
        who = np.flatnonzero(self.seen)
        offset, angle, turned = self.offset[who, choice[who]], self.angle[who, choice[who]], self._turned()[who]
        pose = np.zeros(3)
        design = np.zeros((2 * len(who), 3))
        design[0::2, 0] = design[1::2, 1] = 1
        design[:, 2] = -turned.ravel()
        for _ in range(_ROUNDS):
            rest = offset - pose[:2] + pose[2] * turned
            far = np.hypot(*rest.T) / self.sigma_mm
            weight = np.repeat(np.minimum(1, _LINEAR_FROM / np.maximum(far, 1e-9)), 2) / self.sigma_mm**2
            normal = design.T @ (design * weight[:, None]) + np.diag([self.sigma_mm**-2] * 2 + [_TURN_RAD**-2])
            normal[2, 2] += len(who) / _ROLL_RAD**2
            right = design.T @ (weight * offset.ravel())
            right[2] += angle.sum() / _ROLL_RAD**2
            pose = np.linalg.solve(normal, right)
        return pose

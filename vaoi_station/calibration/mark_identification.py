"""Which mark is which: the layout laid over the marks seen, near where the camera is meant to look.

Marks carry no identity. Pairs of marks seen and pairs of the layout that fit in length and direction give
hypotheses; each is judged by the marks it explains and by those that should be in the frame and are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration.nominal_view import is_in_frame, marks_in_view, nominal_matrix, reach_mm
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

_SCALE, _ANGLE_RAD = 0.08, np.radians(8.0)
"""How far scale and direction may be off the design."""
_SEEDS, _MOST_SEEN = 48, 120
_MISSED = 0.5
"""What a mark that should be in the frame and is not costs, in marks explained."""
_PRIOR_PER_MM2 = 0.04
"""What a shift off the expected place costs: only enough to decide between equals."""
_CHUNK = 64
_MOST_KEPT = 9
_APART_MM, _AS_GOOD = 0.5, 1.0


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way to lay the layout over a frame."""

    similarity: Floats
    """(3, 3) tester mm → px."""
    pairs: NDArray[np.int_]
    """(k, 2): index of the mark in the layout, index of the mark seen."""
    score: float
    offset_mm: Floats
    """How far the view is from its nominal place, (2,)."""


def find_hypotheses(
    seen_px: Floats, marks_mm: Floats, head: CameraHead, camera: int, size_px: float
) -> tuple[Hypothesis, ...]:
    """The best ways to explain the marks seen, the best first; none where fewer than two marks fit.

    Args:
        seen_px: (m, 2) raw pixels, the surest first.
        marks_mm: (k, 2) of the whole layout, tester coordinates.
        head: of the camera.
        camera: its number.
        size_px: of a mark.
    """
    near = marks_in_view(head, camera, marks_mm, reach_mm(head) + size_px / (head.nominal_px_per_mm or 1.0))
    seen = seen_px[:_MOST_SEEN]
    if len(seen) < 2 or len(near) < 2:
        return ()
    trial = _Trial(seen, marks_mm[near], nominal_matrix(head, camera), head, size_px)
    found = trial.judged(trial.from_pairs())
    return tuple(Hypothesis(h.similarity, _renamed(h.pairs, near), h.score, h.offset_mm) for h in found)


def find_rival(options: tuple[Hypothesis, ...], chosen: Hypothesis) -> Hypothesis | None:
    """Another way to lay the layout that explains a frame as well as the chosen one; None if there is none."""
    others = (h for h in options if h is not chosen and np.hypot(*(h.offset_mm - chosen.offset_mm)) > _APART_MM)
    return next((h for h in others if h.score >= chosen.score - _AS_GOOD and len(h.pairs) >= 4), None)


def choose_hypotheses(options: list[tuple[Hypothesis, ...]]) -> list[Hypothesis | None]:
    """One hypothesis per camera: the board was laid once, so among equals the offset the cameras agree on wins."""
    firsts = [_best(o, np.zeros(2)) for o in options]
    offsets = [h.offset_mm for h in firsts if h is not None]
    usual = np.median(np.array(offsets), axis=0) if len(offsets) > 1 else np.zeros(2)
    return [_best(o, usual) for o in options]


def _best(options: tuple[Hypothesis, ...], expected_mm: Floats) -> Hypothesis | None:
    return max(
        options,
        key=lambda h: h.score - _PRIOR_PER_MM2 * float(((h.offset_mm - expected_mm) ** 2).sum()),
        default=None,
    )


def _renamed(pairs: NDArray[np.int_], near: NDArray[np.int_]) -> NDArray[np.int_]:
    return np.column_stack([near[pairs[:, 0]], pairs[:, 1]])


@dataclass(frozen=True, eq=False)
class _Trial:
    """One frame against the part of the layout that it may show."""

    seen: Floats
    marks: Floats
    nominal: Floats
    head: CameraHead
    size_px: float

    def from_pairs(self) -> NDArray[np.complex128]:
        """Similarities (h, 2) as complex factor and shift: image = a · place + b, from pairs that fit."""
        seen, marks = self.seen @ np.array([1, 1j]), self.marks @ np.array([1, 1j])
        between = (marks[None, :] - marks[:, None]) * self.nominal[0, 0]
        found = []
        for first, second in self._seeds():
            way = seen[second] - seen[first]
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = way / between
            fits = (np.abs(np.abs(ratio) - 1) < _SCALE) & (np.abs(np.angle(ratio)) < _ANGLE_RAD)
            i, j = np.nonzero(fits)
            a = way / (marks[j] - marks[i])
            found.append(np.column_stack([a, seen[first] - a * marks[i]]))
        every = np.vstack(found)
        return np.asarray(every[np.hypot(*self._offset_mm(every).T) < reach_mm(self.head)])

    def _seeds(self) -> list[tuple[int, int]]:
        """Pairs of marks seen that are far enough apart to tell a direction."""
        m = len(self.seen)
        first, second = np.triu_indices(m, 1)
        length = np.hypot(*(self.seen[second] - self.seen[first]).T)
        far = np.flatnonzero(length >= np.quantile(length, 0.5))
        chosen = np.random.default_rng(m).permutation(far)[:_SEEDS]
        return [(int(first[k]), int(second[k])) for k in chosen]

    def _offset_mm(self, similarities: NDArray[np.complex128]) -> Floats:
        """Where hypotheses put the middle of the view, minus where the design puts it, (h, 2) mm."""
        middle = complex((self.head.width - 1) / 2, (self.head.height - 1) / 2)
        place = (middle - similarities[:, 1]) / similarities[:, 0]
        design = (middle - complex(self.nominal[0, 2], self.nominal[1, 2])) / self.nominal[0, 0]
        return np.column_stack([(place - design).real, (place - design).imag])

    def judged(self, similarities: NDArray[np.complex128]) -> list[Hypothesis]:
        """The best hypotheses that differ from one another, each improved by all the marks it explains."""
        scores = np.concatenate(
            [self._scores(similarities[k : k + _CHUNK]) for k in range(0, len(similarities), _CHUNK)] or [np.zeros(0)]
        )
        offsets = self._offset_mm(similarities)
        kept: list[int] = []
        cost = _PRIOR_PER_MM2 * (offsets**2).sum(1)
        for n in np.argsort(cost - scores, kind="stable"):
            apart = all(np.hypot(*(offsets[n] - offsets[m])) * self.nominal[0, 0] > self.size_px / 2 for m in kept)
            if apart:
                kept.append(int(n))
            if len(kept) == _MOST_KEPT:
                break
        improved = (self._improved(similarities[n]) for n in kept)
        return sorted((h for h in improved if h is not None), key=lambda h: -h.score)

    def _scores(self, similarities: NDArray[np.complex128]) -> Floats:
        px, near, _ = self._matches(similarities)
        expected = is_in_frame(self.head, px, 0.75 * self.size_px)
        return np.asarray(near.sum(1) - _MISSED * (expected & ~near).sum(1), dtype=np.float64)

    def _matches(self, similarities: NDArray[np.complex128]) -> tuple[Floats, NDArray[np.bool_], NDArray[np.int_]]:
        """Places (h, k, 2) of the marks, whether one was seen there, and which."""
        at = similarities[:, :1] * (self.marks @ np.array([1, 1j])) + similarities[:, 1:]
        distance = np.abs(at[:, :, None] - self.seen @ np.array([1, 1j]))
        return np.stack([at.real, at.imag], -1), distance.min(2) < max(0.25 * self.size_px, 3.0), distance.argmin(2)

    def _improved(self, similarity: NDArray[np.complex128]) -> Hypothesis | None:
        current = similarity[None]
        for _ in range(3):
            _, near, which = self._matches(current)
            mine = np.flatnonzero(near[0])
            if len(mine) < 2:
                return None
            p, q = self.marks[mine] @ np.array([1, 1j]), self.seen[which[0, mine]] @ np.array([1, 1j])
            dp, dq = p - p.mean(), q - q.mean()
            a = (np.conj(dp) * dq).sum() / max(float((np.abs(dp) ** 2).sum()), 1e-12)
            current = np.array([[a, q.mean() - a * p.mean()]])
        _, near, which = self._matches(current)
        mine = np.flatnonzero(near[0])
        a, b = (complex(v) for v in current[0])
        matrix = np.array([[a.real, -a.imag, b.real], [a.imag, a.real, b.imag], [0, 0, 1.0]])
        pairs = np.column_stack([mine, which[0, mine]])
        return Hypothesis(matrix, pairs, float(self._scores(current)[0]), self._offset_mm(current)[0])

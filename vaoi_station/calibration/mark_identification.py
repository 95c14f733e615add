"""Assignment of detected marks to the layout, near the nominal view of the camera.

Detected marks are all alike. Each pair of detected marks that has the length and direction of a pair in the layout
gives a hypothesis. The score of a hypothesis is the logarithm of its likelihood. A detected mark that it explains
raises the score. An expected mark that is missing on blank ground lowers it much. An expected mark that is missing
where something may hide it lowers it little. `array_assignment` then chooses between the hypotheses of all cameras.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration.blank_ground import BlankGround
from vaoi_station.calibration.nominal_view import is_in_frame, marks_in_view, nominal_matrix, reach_mm
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

_SCALE, _ANGLE_RAD = 0.08, np.radians(8.0)
"""Largest accepted deviation of scale (relative) and of direction (rad) from the design."""
_MAX_SEEDS, _MAX_DETECTED = 48, 120
_EXPLAINED = 3.0
"""Amount by which a detected mark that the hypothesis explains raises its score.

The probability that a mark is detected by chance at a place of the layout is about e⁻³."""
_BLANK, _BLANK_CAP, _BLANK_MORE = 4.0, 7.0, 0.3
"""Cost of expected marks that are missing on blank ground, because they are not printed or were not detected.

Each mark costs the first number, up to a total of the second one. Beyond it, a further mark costs only the third
number, because one thing that looks like the ground may cover many marks."""
_HIDDEN, _HIDDEN_CAP, _HIDDEN_MORE = 1.0, 2.0, 0.1
"""Cost of expected marks that are missing where something may hide them.

Each mark costs the first number, up to a total of the second one; beyond it, a further mark costs the third number."""
_CHUNK = 64
"""Number of hypotheses that are scored at a time; it limits the memory of the table of distances."""
_MAX_KEPT = 24
_PRESELECTED_MM = 4.0
"""Standard deviation of the shift from the nominal view, by which hypotheses are sorted before they are scored."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One assignment of detected marks to the layout."""

    similarity: Floats
    """(3, 3) similarity from tester coordinates, mm, to pixels."""
    pairs: NDArray[np.int_]
    """(k, 2): index of the mark in the layout, index of the detected mark."""
    score: float
    offset_mm: Floats
    """Offset of the view from its nominal position, (2,)."""
    nominal_rad: float = 0.0
    """Rotation of the layout in the frame by the design: the nominal roll of the camera."""

    @property
    def angle_rad(self) -> float:
        """Turn of the board in the frame against the design, from image x towards image y."""
        seen = complex(self.similarity[0, 0], self.similarity[1, 0])
        return float(np.angle(seen * np.exp(-1j * self.nominal_rad)))


def find_hypotheses(
    detected_px: Floats,
    marks_mm: Floats,
    head: CameraHead,
    camera: int,
    size_px: float,
    ground: BlankGround | None = None,
) -> tuple[Hypothesis, ...]:
    """Find the best hypotheses about which detected mark (m, 2) is which mark of the layout (k, 2), best first.

    A hypothesis has at least two matches. `ground` states where the frame is blank; by default everywhere.
    """
    near = marks_in_view(head, camera, marks_mm, reach_mm(head) + size_px / (head.nominal_px_per_mm or 1.0))
    seen = detected_px[:_MAX_DETECTED]
    if len(seen) < 2 or len(near) < 2:
        return ()
    matching = _Matching(seen, marks_mm[near], nominal_matrix(head, camera), head, size_px, ground)
    found = matching.select_best(matching.from_pairs())
    # The indices of nearby marks become those of the whole layout.
    return tuple(replace(h, pairs=np.column_stack([near[h.pairs[:, 0]], h.pairs[:, 1]])) for h in found)


def _capped(count: NDArray[np.int_], each: float, cap: float, more: float) -> Floats:
    """Compute the cost of `count` missing marks: `each` for every mark, but less for those beyond `cap`."""
    return np.asarray(np.minimum(each * count, cap + more * count), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Matching:
    """The matching of one frame with the part of the layout that this frame can show."""

    seen: Floats
    marks: Floats
    nominal: Floats
    head: CameraHead
    size_px: float
    ground: BlankGround | None

    @property
    def _design(self) -> complex:
        """The factor from mm to px by the design: its absolute value is the resolution, its angle the camera's roll."""
        return complex(self.nominal[0, 0], self.nominal[1, 0])

    def from_pairs(self) -> NDArray[np.complex128]:
        """Compute a similarity from each matching pair: a (h,) and b (h,), with px = a·mm + b in complex numbers."""
        seen, marks = self.seen @ np.array([1, 1j]), self.marks @ np.array([1, 1j])
        between = (marks[None, :] - marks[:, None]) * self._design
        found = []
        for first, second in self._seeds():
            # A quotient of complex numbers holds the ratio of lengths and the difference of directions. The diagonal
            # divides by zero; the infinity or NaN that results fails both tests.
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
        """Return pairs of detected marks that are far enough apart to give a direction."""
        m = len(self.seen)
        first, second = np.triu_indices(m, 1)
        length = np.hypot(*(self.seen[second] - self.seen[first]).T)
        far = np.flatnonzero(length >= np.quantile(length, 0.5))
        # Seeded by the number of marks: the same frame always gives the same identification.
        chosen = np.random.default_rng(m).permutation(far)[:_MAX_SEEDS]
        return [(int(first[k]), int(second[k])) for k in chosen]

    def _offset_mm(self, similarities: NDArray[np.complex128]) -> Floats:
        """Return by how much the centre of the view is off its nominal position under each hypothesis, (h, 2) mm."""
        middle = complex((self.head.width - 1) / 2, (self.head.height - 1) / 2)
        place = (middle - similarities[:, 1]) / similarities[:, 0]
        design = (middle - complex(self.nominal[0, 2], self.nominal[1, 2])) / self._design
        return np.column_stack([(place - design).real, (place - design).imag])

    def select_best(self, similarities: NDArray[np.complex128]) -> list[Hypothesis]:
        """Return the best distinct hypotheses, each refined with all marks that it explains."""
        scores = np.concatenate(
            [self._scores(similarities[k : k + _CHUNK]) for k in range(0, len(similarities), _CHUNK)] or [np.zeros(0)]
        )
        offsets = self._offset_mm(similarities)
        kept: list[int] = []
        # Linear beyond three standard deviations: a view far from its design is unlikely, but possible.
        far = np.hypot(*offsets.T) / _PRESELECTED_MM
        cost = np.where(far <= 3, far**2 / 2, 3 * far - 4.5)
        for n in np.argsort(cost - scores, kind="stable"):
            apart = all(np.hypot(*(offsets[n] - offsets[m])) * abs(self._design) > self.size_px / 2 for m in kept)
            if apart:
                kept.append(int(n))
            if len(kept) == _MAX_KEPT:
                break
        refined = (self._refine(similarities[n]) for n in kept)
        return sorted((h for h in refined if h is not None), key=lambda h: -h.score)

    def _scores(self, similarities: NDArray[np.complex128]) -> Floats:
        """Return the scores (h,) of h hypotheses: logarithms of their likelihoods, up to a common constant."""
        px, near, _ = self._matches(similarities)
        # A mark cut by the frame's border is not detected, so it does not count as missing.
        expected = is_in_frame(self.head, px, 0.75 * self.size_px)
        missing = expected & ~near
        blank = missing if self.ground is None else missing & self.ground.at(px)
        return np.asarray(
            _EXPLAINED * near.sum(1)
            - _capped(blank.sum(1), _BLANK, _BLANK_CAP, _BLANK_MORE)
            - _capped((missing & ~blank).sum(1), _HIDDEN, _HIDDEN_CAP, _HIDDEN_MORE)
        )

    def _matches(self, similarities: NDArray[np.complex128]) -> tuple[Floats, NDArray[np.bool_], NDArray[np.int_]]:
        """Match all k marks of the layout under h hypotheses.

        Returns the predicted positions (h, k, 2) px, whether a mark was detected there (h, k), and the indices (h, k)
        of the nearest detected marks.
        """
        at = similarities[:, :1] * (self.marks @ np.array([1, 1j])) + similarities[:, 1:]
        distance = np.abs(at[:, :, None] - self.seen @ np.array([1, 1j]))
        return np.stack([at.real, at.imag], -1), distance.min(2) < max(0.25 * self.size_px, 3.0), distance.argmin(2)

    def _refine(self, similarity: NDArray[np.complex128]) -> Hypothesis | None:
        """Refine a hypothesis by least squares over all marks that it explains; None if it explains fewer than two."""
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
        score, offset_mm = float(self._scores(current)[0]), self._offset_mm(current)[0]
        return Hypothesis(matrix, pairs, score, offset_mm, float(np.angle(self._design)))

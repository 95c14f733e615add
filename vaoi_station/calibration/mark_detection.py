"""Detection of calibration marks in one frame, and measurement of its blur."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.calibrations import Layout
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, find_candidates, locate_mark
from vaoi_station.marks.blur import measure_blur_px, steepest_edge_blur

SURROUND = 1.3
"""Diameter of the compared disc, divided by the size of the mark.

Calibration marks can be close together, so the compared rim around a mark is narrow."""
COARSE_PX = 10.0
"""Approximate size of marks in the reduced frame of the search, px."""
_MAX_CANDIDATES = 400
_SCORE_MARGIN = (0.02, 0.08)
_SCORE_FACTOR = 3.0
"""A mark is covered or damaged if its correlation is lower than that of the other marks of its frame.

The limit is `_SCORE_FACTOR` times their usual distance from 1, but within `_SCORE_MARGIN`. In even light, the scores of
complete marks differ by half that distance."""


@dataclass(frozen=True)
class MarkAppearance:
    """Size, arm width and polarity of marks in one frame."""

    size_px: float
    arm: float
    light: bool

    @classmethod
    def of(cls, layout: Layout, px_per_mm: float) -> MarkAppearance:
        """Return the appearance that the marks of a layout have at a resolution."""
        mark = layout.mark
        return cls(mark.size * layout.mm_per_unit * px_per_mm, mark.width / mark.size, mark.polarity == "light")

    @property
    def margin_px(self) -> float:
        """Smallest distance of a mark's centre from the frame's border at which the mark can be measured."""
        return float(np.ceil(SURROUND * self.size_px / 2)) + 5


@dataclass(frozen=True, eq=False)
class DetectedMarks:
    """The marks detected in one frame, best first, and rejected candidates."""

    px: Floats
    """(k, 2) positions of the marks in raw pixels."""
    score: Floats
    blur_px: float
    """Standard deviation of the blur, measured at the edges of the marks or, without marks, in the whole frame."""
    doubtful: tuple[tuple[tuple[float, float], str], ...] = ()
    """Positions of rejected marks in px, each with the cause of the rejection."""
    opposite: int = 0
    """Number of detected marks of the opposite polarity: dark in place of light, or light in place of dark."""
    contrast: float = 0.0
    """Difference between the darkest and the lightest parts of the frame, grey levels."""
    grey: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))


def detect_marks(grey: NDArray[np.uint8], kind: MarkAppearance) -> DetectedMarks:
    """Search a whole frame (h, w) for marks."""
    low, high = (float(v) for v in np.percentile(grey[::4, ::4], [0.5, 99.5]))
    factor = 2 ** max(int(np.log2(kind.size_px / COARSE_PX)), 0) if kind.size_px > COARSE_PX else 1
    h, w = (side // factor * factor for side in grey.shape)
    small = cv2.resize(grey[:h, :w], (w // factor, h // factor), interpolation=cv2.INTER_AREA)
    places, _ = find_candidates(small, "cross", kind.size_px / factor, _MAX_CANDIDATES, arm=kind.arm)
    # Candidates are sorted, best first, so that of two candidates on one mark the better one is kept.
    marks: list[Mark] = []
    opposite = 0
    for place in (places + 0.5) * factor - 0.5:
        mark = locate_cross(grey, place, kind)
        if isinstance(mark, Mark):
            opposite += mark.light != kind.light
            if mark.light == kind.light and all(np.hypot(*(mark.px - m.px)) > kind.size_px / 2 for m in marks):
                marks.append(mark)
    kept, doubtful = _reject_outliers(marks)
    blur = (
        measure_blur_px(grey, np.array([m.px for m in kept]), kind.size_px)
        if kept
        else steepest_edge_blur(grey, high - low)
    )
    return DetectedMarks(
        np.array([m.px for m in kept]).reshape(-1, 2),
        np.array([m.score for m in kept]),
        blur,
        doubtful,
        opposite,
        high - low,
        grey,
    )


def locate_cross(grey: NDArray[np.uint8], near_px: Floats, kind: MarkAppearance) -> Mark | Failure:
    """Locate one mark near a position that is accurate to a third of the mark's size."""
    return locate_mark(grey, near_px, "cross", kind.size_px, arm=kind.arm, surround=SURROUND)


def score_limit(scores: Floats) -> float:
    """Compute the lowest accepted correlation of a mark, given the scores of the marks of its frame."""
    usual = float(np.median(scores)) if len(scores) else 1.0
    return usual - float(np.clip(_SCORE_FACTOR * (1 - usual), *_SCORE_MARGIN))


def _reject_outliers(marks: list[Mark]) -> tuple[list[Mark], tuple[tuple[tuple[float, float], str], ...]]:
    """Return the accepted marks, and the positions of the rejected ones with the cause."""
    # With one or two marks, the median of the scores means nothing.
    if len(marks) < 3:
        return marks, ()
    least = score_limit(np.array([m.score for m in marks]))
    kept = [m for m in marks if m.score >= least]
    why = f"is less similar to the artwork than the others (correlation below {least:.2f}): covered or damaged"
    doubtful = tuple(((float(m.px[0]), float(m.px[1])), f"{why}, with {m.score:.2f}") for m in marks if m.score < least)
    return kept, doubtful

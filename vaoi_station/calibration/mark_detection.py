"""What looks like a mark of the calibration board in one frame, and how sharp the picture is."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import Image
from vaoi_station.files.layouts import Layout
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, find_candidates, locate_mark

SURROUND = 1.3
"""Marks of a calibration board may stand closer than fiducials: no more bare rim than this is asked for."""
_COARSE_PX = 10.0
"""Marks are searched where they are about so large."""
_MOST = 400
_STEEPEST = 200
"""Pixels on edges that tell the blur."""
_ALIKE = (0.02, 0.08)
_ALIKE_FACTOR = 3.0
"""A mark that is less like the artwork than the others of its frame is covered or damaged: by three times what those
lack to a correlation of 1, within these limits. In even light whole marks differ by half of that lack."""


@dataclass(frozen=True)
class MarkAppearance:
    """How a mark looks in one frame."""

    size_px: float
    arm: float
    light: bool

    @classmethod
    def of(cls, layout: Layout, px_per_mm: float) -> MarkAppearance:
        """The marks of a layout at a resolution."""
        mark = layout.mark
        return cls(mark.size * layout.mm_per_unit * px_per_mm, mark.width / mark.size, mark.polarity == "light")

    @property
    def margin_px(self) -> float:
        """How far from the frame's border a mark must be to be measured."""
        return float(np.ceil(SURROUND * self.size_px / 2)) + 5


@dataclass(frozen=True, eq=False)
class DetectedMarks:
    """The marks seen in one frame, best first, and what was seen but not taken."""

    px: Floats
    """(k, 2) raw pixels."""
    score: Floats
    blur_px: float
    """Standard deviation of the blur, from the edges of the marks; of the whole picture where there are none."""
    doubtful: tuple[tuple[tuple[float, float], str], ...] = ()
    """Places and why they are not taken for marks."""
    opposite: int = 0
    """Marks of the other polarity."""
    contrast: float = 0.0
    """Of the picture: what separates its darkest from its lightest parts, in grey levels."""
    grey: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))


def to_grey(image: Image) -> NDArray[np.uint8]:
    """Any frame as 8-bit grey; 16-bit frames are stretched, as their sensors may fill a few bits only."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    if grey.dtype == np.uint8:
        return np.asarray(grey)
    top = max(float(np.percentile(grey, 99.9)), 1.0)
    return np.asarray(np.clip(np.rint(grey * (250.0 / top)), 0, 255), dtype=np.uint8)


def detect_marks(grey: NDArray[np.uint8], kind: MarkAppearance) -> DetectedMarks:
    """Search a whole frame for marks.

    Args:
        grey: (h, w).
        kind: how they look.
    """
    low, high = (float(v) for v in np.percentile(grey[::4, ::4], [0.5, 99.5]))
    factor = 2 ** max(int(np.log2(kind.size_px / _COARSE_PX)), 0) if kind.size_px > _COARSE_PX else 1
    h, w = (side // factor * factor for side in grey.shape)
    small = cv2.resize(grey[:h, :w], (w // factor, h // factor), interpolation=cv2.INTER_AREA)
    places, _ = find_candidates(small, "cross", kind.size_px / factor, _MOST, arm=kind.arm)
    marks: list[Mark] = []
    opposite = 0
    for place in (places + 0.5) * factor - 0.5:
        mark = locate_cross(grey, place, kind)
        if isinstance(mark, Mark):
            opposite += mark.light != kind.light
            if mark.light == kind.light and all(np.hypot(*(mark.px - m.px)) > kind.size_px / 2 for m in marks):
                marks.append(mark)
    kept, doubtful = _alike(marks)
    blur = blur_px(grey, np.array([m.px for m in kept]), kind.size_px) if kept else _blur_of_picture(grey, high - low)
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
    """One mark near a place that is right to a third of its size."""
    return locate_mark(grey, near_px, "cross", kind.size_px, arm=kind.arm, surround=SURROUND)


def blur_px(grey: NDArray[np.uint8], px: Floats, size_px: float) -> float:
    """Median standard deviation of the blur across the edges of marks at px (k, 2).

    An edge of height C blurred by sigma is steepest by C / (sigma √(2π)); the pixel's own width is part of it.
    """
    half, found = int(np.ceil(0.6 * size_px)), []
    for x, y in np.round(px).astype(int):
        patch = grey[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
        low, high = (float(v) for v in np.percentile(patch, [5, 95]))
        found.append(_blur_of_picture(patch, high - low))
    return float(np.median(found))


def _blur_of_picture(patch: NDArray[np.uint8], contrast: float) -> float:
    """Blur of the steepest edges; the smoothing that keeps noise out of the slopes is taken off again."""
    smooth = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), 1.0)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    slopes = np.hypot(gx, gy).ravel()
    few = min(_STEEPEST, slopes.size // 20 + 1)
    steepest = max(float(np.median(np.partition(slopes, -few)[-few:])), 1e-6)
    return float(np.sqrt(max((contrast / (steepest * np.sqrt(2 * np.pi))) ** 2 - 1.3, 0.0)))


def least_score(scores: Floats) -> float:
    """How like the artwork a mark must be where the others of its frame are so."""
    usual = float(np.median(scores)) if len(scores) else 1.0
    return usual - float(np.clip(_ALIKE_FACTOR * (1 - usual), *_ALIKE))


def _alike(marks: list[Mark]) -> tuple[list[Mark], tuple[tuple[tuple[float, float], str], ...]]:
    """Marks as alike the artwork as the rest of the frame, and the others with the reason."""
    if len(marks) < 3:
        return marks, ()
    least = least_score(np.array([m.score for m in marks]))
    kept = [m for m in marks if m.score >= least]
    why = f"is less like the artwork than the others (correlation below {least:.2f}): covered or damaged"
    doubtful = tuple(((float(m.px[0]), float(m.px[1])), f"{why}, with {m.score:.2f}") for m in marks if m.score < least)
    return kept, doubtful

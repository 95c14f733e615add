"""Inspection of one frame: focus and exposure, detected marks, and remarks for the person who mounts the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration.mark_detection import SURROUND, MarkAppearance, detect_marks
from vaoi_station.files.images import Image
from vaoi_station.geometry.robust import Failure
from vaoi_station.marks import find_candidates, locate_mark
from vaoi_station.marks.candidate_search import reduction_factor
from vaoi_station.photometry.image_quality import ImageQuality, measure_quality
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.viewing.mark_spec import MarkSpec

_MAX_MARKS = 200
"""Largest number of candidates per frame. A frame of a calibration board shows fewer marks."""
SATURATED_LIMIT = 0.005
"""Largest accepted share of saturated pixels."""
DARK_LIMIT = 0.35
"""Least accepted 99th percentile of the grey levels, as a share of the full scale."""
BLUR_LIMIT_PX = 1.3
"""Largest accepted blur, standard deviation in px."""
TILT_LIMIT = 1.5
"""Largest accepted ratio between the blurs of two parts of a frame. Above it a tilted camera is reported."""
LEAST_MARKS = 4
"""Least number of marks for a calibration: a homography has eight parameters, and a mark gives two equations."""


@dataclass(frozen=True)
class MarkDetection:
    """A mark found in a frame, in raw px. `doubt` says why the mark is not used; empty if it is used."""

    x: float
    y: float
    score: float
    doubt: str = ""


@dataclass(frozen=True)
class FrameInspection:
    """The outcome of the inspection of one frame."""

    quality: ImageQuality
    marks: tuple[MarkDetection, ...]
    size_px: float | None
    """Expected size of a mark in px; None if no marks are searched."""
    expected: int | None
    remarks: tuple[str, ...]


def inspect_frame(pixels: Image, spec: MarkSpec | None) -> FrameInspection:
    """Measure a frame and detect the marks in it."""
    quality = measure_quality(pixels)
    marks = () if spec is None else find_marks(eight_bit_grey(pixels), spec)
    remarks = (*_exposure_remarks(quality), *_focus_remarks(quality), *_mark_remarks(marks, spec))
    return FrameInspection(quality, marks, spec.size_px if spec else None, spec.expected if spec else None, remarks)


def find_marks(grey: NDArray[np.uint8], spec: MarkSpec) -> tuple[MarkDetection, ...]:
    """Detect all marks of a frame. Crosses of a known polarity are detected by the method of `vaoi calibrate`."""
    if spec.shape == "cross" and spec.light is not None:
        found = detect_marks(grey, MarkAppearance(spec.size_px, spec.arm, spec.light))
        sure = [MarkDetection(float(x), float(y), float(s)) for (x, y), s in zip(found.px, found.score, strict=True)]
        return (*sure, *(MarkDetection(x, y, 0.0, why) for (x, y), why in found.doubtful))
    # The search runs on a reduced frame; each place is then refined at full resolution.
    factor = reduction_factor(spec.size_px)
    h, w = (side // factor * factor for side in grey.shape)
    small = grey[:h, :w].reshape(h // factor, factor, w // factor, factor).mean(axis=(1, 3)).astype(np.uint8)
    places, _ = find_candidates(small, spec.shape, spec.size_px / factor, _MAX_MARKS, arm=spec.arm)
    marks: list[MarkDetection] = []
    for place in (places + 0.5) * factor - 0.5:
        mark = locate_mark(grey, place, spec.shape, spec.size_px, arm=spec.arm, surround=SURROUND)
        if isinstance(mark, Failure):
            continue
        x, y = (float(v) for v in mark.px)
        # Two candidates may be refined to the same mark.
        if all(np.hypot(x - m.x, y - m.y) > spec.size_px / 2 for m in marks):
            marks.append(MarkDetection(x, y, float(mark.score)))
    return tuple(marks)


def _exposure_remarks(f: ImageQuality) -> list[str]:
    if f.saturated > SATURATED_LIMIT:
        return [
            f"too bright: {100 * f.saturated:.1f} % of the pixels are saturated (limit {100 * SATURATED_LIMIT:.1f} %)"
        ]
    if f.high < DARK_LIMIT:
        return [f"dark: the 99th percentile is {100 * f.high:.0f} % of full scale (at least {100 * DARK_LIMIT:.0f} %)"]
    return []


def _focus_remarks(f: ImageQuality) -> list[str]:
    if f.blur_px is None:
        return ["no edges: blur cannot be measured"]
    if f.blur_px > BLUR_LIMIT_PX:
        return [f"blurred by {f.blur_px:.2f} px (good: below {BLUR_LIMIT_PX} px)"]
    # The blur of the sharpest part counts as at least half a pixel, because ratios of smaller blurs are noise.
    parts = [b for row in f.blur_tiles_px for b in row if b is not None]
    worst, best = max(parts, default=0.0), max(min(parts, default=0.0), 0.5)
    if worst > BLUR_LIMIT_PX and worst > TILT_LIMIT * best:
        return [f"unevenly sharp: blur {best:.2f} to {worst:.2f} px; check the camera for tilt"]
    return []


def _mark_remarks(marks: tuple[MarkDetection, ...], spec: MarkSpec | None) -> list[str]:
    if spec is None:
        return []
    sure = sum(1 for m in marks if not m.doubt)
    if not sure:
        return ["no mark found"]
    if spec.light is None:
        return []
    if sure < LEAST_MARKS:
        return [f"marks found: {sure}; a calibration needs {LEAST_MARKS}"]
    if spec.expected is not None and sure < spec.expected:
        return [f"marks found: {sure} of {spec.expected} expected in view"]
    return []

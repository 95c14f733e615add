"""The picture of a calibration: every frame with the marks found, the places expected, and the residuals enlarged."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from vaoi_station.calibration.array_calibration import Outcome
from vaoi_station.calibration.camera_fit import CameraResult
from vaoi_station.calibration.tile_sheet import Picture, arrange_tiles
from vaoi_station.geometry.transforms import Floats

_WIDTH, _BAND = 720, 74
_FOUND, _EXPECTED, _MISSED, _STRANGE, _VECTOR = (
    (60, 200, 60),
    (230, 150, 40),
    (40, 40, 230),
    (0, 200, 230),
    (220, 0, 220),
)
_INK, _PAPER, _RED = (30, 30, 30), (250, 250, 250), (30, 30, 200)
_LONGEST_VECTOR = 60.0
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_calibration(outcome: Outcome) -> Picture:
    """All cameras side by side, (h, w, 3) BGR: green found, blue expected, red not used, yellow in no layout.

    Residual vectors are enlarged by the factor that the caption tells, the same for all cameras.
    """
    factor = _enlargement(outcome.cameras)
    tiles = [_tile(c, factor, outcome.limits.residual_px) for c in outcome.cameras]
    return arrange_tiles(tiles)


def _enlargement(cameras: Sequence[CameraResult]) -> int:
    lengths = [float(np.hypot(*m.residual_px)) for c in cameras for m in c.marks if m.residual_px is not None]
    longest = max(lengths, default=0.0)
    return 1 if longest < 1e-6 else int(10 ** math.floor(math.log10(max(_LONGEST_VECTOR / longest, 1.0))))


def _tile(result: CameraResult, factor: int, limit_px: float) -> Picture:
    """One camera: caption, frame, drawings."""
    grey = result.detected.grey
    scale = _WIDTH / grey.shape[1]
    size = (_WIDTH, max(round(grey.shape[0] * scale), 1))
    frame = cv2.cvtColor(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR)
    frame = np.asarray(frame // 2 + 110, dtype=np.uint8)
    _draw_marks(frame, result, scale, factor)
    band = np.full((_BAND, _WIDTH, 3), _PAPER, np.uint8)
    for k, (line, ink) in enumerate(_caption(result, factor, limit_px)):
        cv2.putText(band, line, (8, 18 + 17 * k), _FONT, 0.42, ink, 1, cv2.LINE_AA)
    return np.vstack([band, frame])


def _draw_marks(frame: Picture, result: CameraResult, scale: float, factor: int) -> None:
    r = 9
    known = np.array([m.px for m in result.marks if m.px is not None]).reshape(-1, 2)
    for px in result.detected.px:
        if not len(known) or np.hypot(*(known - px).T).min() > 1:
            cv2.circle(frame, _at(px, scale), r + 4, _STRANGE, 2, cv2.LINE_AA)
    for (x, y), _ in result.detected.doubtful:
        cv2.circle(frame, _at(np.array([x, y]), scale), r + 4, _STRANGE, 1, cv2.LINE_AA)
    laid = result.fit is not None or any(m.px is not None for m in result.marks)
    for m in result.marks:
        x, y = _at(m.expected_px, scale)
        cv2.rectangle(frame, (x - r, y - r), (x + r, y + r), _EXPECTED, 1, cv2.LINE_AA)
        fine = m.used or (result.fit is None and m.px is not None)
        if m.px is not None:
            cv2.drawMarker(frame, _at(m.px, scale), _FOUND if fine else _MISSED, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)
        if not fine and laid:
            cv2.drawMarker(frame, (x, y), _MISSED, cv2.MARKER_TILTED_CROSS, 2 * r, 2, cv2.LINE_AA)
        if m.px is not None and m.residual_px is not None:
            tip = m.px + m.residual_px * factor
            cv2.arrowedLine(frame, _at(m.px, scale), _at(tip, scale), _VECTOR, 2, cv2.LINE_AA, tipLength=0.25)


def _caption(result: CameraResult, factor: int, limit_px: float) -> list[tuple[str, tuple[int, int, int]]]:
    lines = [
        (
            f"camera {result.camera}: {result.used} of {len(result.marks)} marks used, {len(result.detected.px)} seen, "
            f"blur {result.detected.blur_px:.1f} px, contrast {result.detected.contrast:.0f}",
            _INK,
        )
    ]
    if result.fit is not None:
        lines.append(
            (
                f"residuals {result.fit.rms_px:.4f} px rms (limit {limit_px:g}), corners good to "
                f"{result.corner_sigma_px:.3f} px; vectors x{factor}",
                _INK,
            )
        )
    if result.refusal:
        said = "REFUSED: " + result.refusal
        lines += [(line, _RED) for line in _wrapped(said, 100)]
    elif result.notes:
        lines += [(line, _INK) for line in _wrapped(result.notes[0], 100)]
    return [(line.encode("ascii", "replace").decode(), ink) for line, ink in lines[:4]]


def _wrapped(text: str, width: int) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if len(line) + len(word) >= width:
            lines.append(line)
            line = ""
        line = f"{line} {word}".strip()
    return [*lines, line]


def _at(px: Floats, scale: float) -> tuple[int, int]:
    """A place in the reduced frame; far-off ones are kept within what the drawing routines take."""
    x, y = np.clip((np.asarray(px) + 0.5) * scale - 0.5, -5000, 15000)
    return round(float(x)), round(float(y))

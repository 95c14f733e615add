"""The picture of a calibration: each frame with detected marks, expected positions and enlarged residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from vaoi_station.calibration.array_calibration import Outcome
from vaoi_station.calibration.camera_fit import CameraResult
from vaoi_station.calibration.pictures.tile_sheet import Picture, arrange_tiles
from vaoi_station.geometry.transforms import Floats

_WIDTH, _BAND = 720, 74
_DETECTED, _EXPECTED, _UNUSED, _FOREIGN, _VECTOR = (
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
    """Draw all cameras side by side, (h, w, 3) BGR.

    Green marks are detected, blue ones expected, red ones unused, yellow ones not in the layout. Residual vectors are
    enlarged by the factor in the caption, which is the same for all cameras.
    """
    factor = _enlargement(outcome.cameras)
    tiles = [_tile(c, factor, outcome.limits.residual_px) for c in outcome.cameras]
    return arrange_tiles(tiles)


def _enlargement(cameras: Sequence[CameraResult]) -> int:
    lengths = [float(np.hypot(*m.residual_px)) for c in cameras for m in c.marks if m.residual_px is not None]
    longest = max(lengths, default=0.0)
    return 1 if longest < 1e-6 else int(10 ** math.floor(math.log10(max(_LONGEST_VECTOR / longest, 1.0))))


def _tile(result: CameraResult, factor: int, limit_px: float) -> Picture:
    grey = result.detected.grey
    scale = _WIDTH / grey.shape[1]
    size = (_WIDTH, max(round(grey.shape[0] * scale), 1))
    frame = cv2.cvtColor(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR)
    # The contrast is halved, on a light ground, so that coloured marks stand out on dark and light parts of the frame.
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
            cv2.circle(frame, _tile_position(px, scale), r + 4, _FOREIGN, 2, cv2.LINE_AA)
    for (x, y), _ in result.detected.doubtful:
        cv2.circle(frame, _tile_position(np.array([x, y]), scale), r + 4, _FOREIGN, 1, cv2.LINE_AA)
    # Without any identified mark, the expected positions are only nominal, so none of them is shown as missing.
    identified = result.fit is not None or any(m.px is not None for m in result.marks)
    for m in result.marks:
        x, y = _tile_position(m.expected_px, scale)
        cv2.rectangle(frame, (x - r, y - r), (x + r, y + r), _EXPECTED, 1, cv2.LINE_AA)
        good = m.used or (result.fit is None and m.px is not None)
        if m.px is not None:
            cv2.drawMarker(
                frame, _tile_position(m.px, scale), _DETECTED if good else _UNUSED, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA
            )
        if not good and identified:
            cv2.drawMarker(frame, (x, y), _UNUSED, cv2.MARKER_TILTED_CROSS, 2 * r, 2, cv2.LINE_AA)
        if m.px is not None and m.residual_px is not None:
            tip = m.px + m.residual_px * factor
            cv2.arrowedLine(
                frame, _tile_position(m.px, scale), _tile_position(tip, scale), _VECTOR, 2, cv2.LINE_AA, tipLength=0.25
            )


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
                f"residuals {result.fit.rms_px:.4f} px rms (limit {limit_px:g}), sigma at frame corners "
                f"{result.corner_sigma_px:.3f} px; vectors x{factor}",
                _INK,
            )
        )
    if result.refusal:
        text = "REFUSED: " + result.refusal
        lines += [(line, _RED) for line in _wrapped(text, 100)]
    elif result.notes:
        lines += [(line, _INK) for line in _wrapped(result.notes[0], 100)]
    # OpenCV's Hershey fonts contain ASCII only.
    return [(line.encode("ascii", "replace").decode(), ink) for line, ink in lines[:4]]


def _wrapped(text: str, width: int) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if len(line) + len(word) >= width:
            lines.append(line)
            line = ""
        line = f"{line} {word}".strip()
    return [*lines, line]


def _tile_position(px: Floats, scale: float) -> tuple[int, int]:
    # Far-off positions are clipped to a range that OpenCV's drawing functions accept.
    x, y = np.clip((np.asarray(px) + 0.5) * scale - 0.5, -5000, 15000)
    return round(float(x)), round(float(y))

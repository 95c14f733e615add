"""The picture of a comparison: the difference of two calibrations over each frame.

Colours show the size of the difference, on one scale for all cameras with a colour bar. Arrows show its direction,
enlarged by a round factor. Frames have a margin, so that arrows at their borders are complete.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from vaoi_station.calibration.calibration_difference import CalibrationDifference
from vaoi_station.calibration.pictures.tile_sheet import Picture, arrange_tiles
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import CameraHead

WIDTH = 460
"""Width of a frame in the picture, px."""
MARGIN = 50
"""Margin around a frame in the picture, px. Arrows are not longer than the margin."""
BAND = 30
_FOOT = 86
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_INK, _PAPER, _ARROW = (30, 30, 30), (250, 250, 250), (255, 255, 255)
_ROUND_NUMBERS = (1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


def draw_difference(difference: CalibrationDifference, heads: Sequence[CameraHead]) -> Picture:
    """Draw the difference of all cameras above a colour bar, as an image (h, w, 3) BGR. Figures are in frame pixels."""
    # One scale and one factor for all cameras, so that they can be compared by eye.
    top_px = round_up(max(*difference.max_px, 1e-3))
    largest_px = max(*difference.max_px, 1e-9)
    factor = round_down(min((MARGIN - 4) / (largest_px * WIDTH / head.width) for head in heads))
    sheet = arrange_tiles([_tile(difference, i, head, top_px, factor) for i, head in enumerate(heads)])
    foot = _foot(sheet.shape[1], top_px, factor, difference.one_board)
    return np.vstack([sheet, foot])


def round_up(value: float) -> float:
    """Round a positive value up to 1, 1.2, 1.5, 2, 3 … 10 or one of their decimal multiples."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(s * power for s in _ROUND_NUMBERS if s * power >= value * (1 - 1e-9))


def round_down(value: float) -> float:
    """Round a positive value down to 1, 1.2, 1.5, 2, 3 … 10 or one of their decimal multiples."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(s * power for s in reversed(_ROUND_NUMBERS) if s * power <= value * (1 + 1e-9))


def _tile(difference: CalibrationDifference, camera: int, head: CameraHead, top_px: float, factor: float) -> Picture:
    scale, d_px = WIDTH / head.width, difference.difference_px[camera]
    size = (WIDTH, max(round(head.height * scale), 1))
    lengths = np.sqrt((d_px**2).sum(-1)).astype(np.float32)
    shades = np.clip(_interpolate(lengths, size) * (255 / top_px), 0, 255).astype(np.uint8)
    tile = np.full((size[1] + 2 * MARGIN, WIDTH + 2 * MARGIN, 3), _PAPER, np.uint8)
    tile[MARGIN:-MARGIN, MARGIN:-MARGIN] = cv2.applyColorMap(shades, cv2.COLORMAP_VIRIDIS)
    for place, d in zip(difference.grid_px[camera].reshape(-1, 2), d_px.reshape(-1, 2), strict=True):
        _arrow(tile, (place + 0.5) * scale - 0.5 + MARGIN, d * factor * scale)
    band = np.full((BAND, tile.shape[1], 3), _PAPER, np.uint8)
    rms, longest = difference.rms_px[camera], difference.max_px[camera]
    _write(band, f"camera {camera}: {rms:.3f} px rms, {longest:.3f} px at most", (MARGIN, BAND - 10))
    return np.vstack([band, tile])


def _interpolate(lengths: Floats, size: tuple[int, int]) -> Floats:
    """Interpolate values of the grid to all pixels (h, w); the outermost grid points lie on the border."""
    rows, columns = lengths.shape
    x, y = np.linspace(0, columns - 1, size[0]), np.linspace(0, rows - 1, size[1])
    at_x, at_y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return np.asarray(cv2.remap(lengths, at_x, at_y, cv2.INTER_LINEAR))


def _arrow(picture: Picture, foot: Floats, way: Floats) -> None:
    """Draw an arrow that starts at `foot` and has the vector `way`, both in pixels of the picture."""
    # White with a dark edge is visible on white and on each colour of the scale.
    start, tip = (tuple(round(float(v)) for v in p) for p in (foot, foot + way))
    for ink, width in ((_INK, 3), (_ARROW, 1)):
        cv2.circle(picture, start, 1, ink, width, cv2.LINE_AA)
        cv2.arrowedLine(picture, start, tip, ink, width, cv2.LINE_AA, tipLength=0.2)


def _foot(width: int, top_px: float, factor: float, one_board: bool) -> Picture:
    foot = np.full((_FOOT, width, 3), _PAPER, np.uint8)
    ramp = np.tile(np.linspace(0, 255, WIDTH // 2).astype(np.uint8), (12, 1))
    foot[10:22, MARGIN : MARGIN + WIDTH // 2] = cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)
    for share in (0.0, 0.5, 1.0):
        x = MARGIN + round(share * (WIDTH // 2 - 1))
        cv2.line(foot, (x, 22), (x, 26), _INK, 1)
        _write(foot, f"{share * top_px:g}" + (" px" if share == 1 else ""), (x - 4, 40))
    _write(foot, f"arrows x{factor:g}: displacement of a pixel in the other calibration", (MARGIN, 60))
    if not one_board:
        _write(foot, "a motion common to all cameras is removed", (MARGIN, 78))
    return foot


def _write(picture: Picture, words: str, at: tuple[int, int]) -> None:
    cv2.putText(picture, words, at, _FONT, 0.45, _INK, 1, cv2.LINE_AA)

"""Drawings of DataMatrix codes of dots, as lasers and dot peening make them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import zxingcpp
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

_FINE = 8
"""Number of drawn pixels per pixel of the picture."""


@dataclass(frozen=True)
class DottedCode:
    """How a code of dots is drawn."""

    version: int = 3
    text: str = "12345678"
    module_px: float = 6.0
    dot: float = 0.85
    inverted: bool = False
    turned_deg: float = 0.0
    grey: tuple[float, float] = (70.0, 170.0)
    noise: float = 3.0
    blur_px: float = 0.7
    size_spread: float = 0.0
    displaced: float = 0.0
    """Largest displacement of a dot along each axis, in modules."""
    missing: float = 0.0
    oblique: float = 0.0
    """How much larger the nearest side of the code is than the farthest, about, as a share."""
    brushed: float = 0.0
    """Standard deviation of a ground with stripes, grey levels."""
    shaded: float = 0.0
    """Difference of the ground's brightness from one side to the other, grey levels."""
    room: float = 1.7
    """Side of the picture, as a multiple of the code's longer one."""
    parts: int = 0
    """Number of parts beside the code, as light or dark as its dots, at least one module away."""
    label: float | None = None
    """Width of the ground round the code in modules; what is farther away is as light or dark as the dots."""
    seed: int = 0


def draw_dotted_code(code: DottedCode) -> tuple[NDArray[np.uint8], Floats]:
    """Draw a code of dots; return the picture and the code's corners (4, 2) in it, from its own top left one on."""
    written = zxingcpp.create_barcode(code.text, zxingcpp.BarcodeFormat.DataMatrix, version=code.version)
    dark = np.array(written.to_image(scale=1, add_quiet_zones=False)) < 128
    g = np.random.default_rng(code.seed)
    size = np.array(dark.shape[::-1])
    side = int(code.module_px * size.max() * code.room) + 20
    a = math.radians(code.turned_deg)
    turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) * code.module_px
    tilt = g.uniform(-1, 1, 2) * code.oblique / size.max()
    middle = (side - 1) / 2 + g.uniform(-2, 2, 2)

    def to_px(modules: Any) -> Floats:
        from_middle = np.asarray(modules, np.float64) - size / 2
        return np.asarray((from_middle / (1 + from_middle @ tilt)[..., None]) @ turn.T + middle)

    fine = np.zeros((side * _FINE, side * _FINE), np.uint8)
    margin = code.label or 0.0
    (w, h), low, high = size, np.full(2, -margin), size + margin
    if code.label is not None:
        fine[:] = 255
        edge = to_px([low, (high[0], low[1]), high, (low[0], high[1])])
        cv2.fillPoly(fine, [np.round(_to_fine(edge)).astype(np.int32)], 0)
    for y, x in np.argwhere(dark):
        place = to_px((x + 0.5, y + 0.5) + g.uniform(-1, 1, 2) * code.displaced)
        diameter = code.dot * (1 + g.uniform(-1, 1) * code.size_spread)
        if g.random() >= code.missing:
            _draw_disk(fine, place, diameter * code.module_px / 2)
    corners = to_px([(0, 0), (w, 0), (w, h), (0, h)])
    _draw_parts(fine, corners, code, g)
    cover = cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    dots, ground = code.grey[::-1] if code.inverted else code.grey
    picture = ground + (dots - ground) * cover + code.brushed * _stripes(side, g)
    picture = cv2.GaussianBlur(picture, (0, 0), code.blur_px)
    picture += code.shaded * (np.arange(side) / side - 0.5) + g.normal(0, code.noise, picture.shape)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8), corners


def _draw_parts(fine: NDArray[np.uint8], corners: Floats, code: DottedCode, g: np.random.Generator) -> None:
    """Draw disks and bars beside a code."""
    outline = corners.astype(np.float32)
    for n in range(code.parts):
        place, reach = g.uniform(0, len(fine) / _FINE, 2), g.uniform(0.5, 2) * code.module_px
        if cv2.pointPolygonTest(outline, tuple(map(float, place)), True) > -reach - code.module_px:
            continue
        if n % 2:
            _draw_disk(fine, place, reach)
        else:
            along = np.array([math.cos(n), math.sin(n)]) * reach * 0.8
            ends = [tuple(np.round(_to_fine(place + s * along)).astype(int).tolist()) for s in (-1, 1)]
            cv2.line(fine, ends[0], ends[1], 255, max(int(0.3 * reach * _FINE), 1))


def _draw_disk(fine: NDArray[np.uint8], place: Floats, radius_px: float) -> None:
    x, y = np.round(16 * _to_fine(place)).astype(int).tolist()
    cv2.circle(fine, (x, y), round(16 * radius_px * _FINE), 255, -1, shift=4)


def _to_fine(px: Floats) -> Floats:
    return (px + 0.5) * _FINE - 0.5


def _stripes(side: int, g: np.random.Generator) -> Floats:
    """Return a ground of stripes in any direction, with a standard deviation of 1."""
    along = cv2.GaussianBlur(g.normal(0, 1, (side, side)), (0, 0), sigmaX=12, sigmaY=0.6)
    turn = cv2.getRotationMatrix2D((side / 2, side / 2), g.uniform(0, 180), 1.5)
    turned = cv2.warpAffine(along, turn, (side, side), borderMode=cv2.BORDER_REFLECT)
    return np.asarray(turned / turned.std(), np.float64)

"""Paint shapes given in millimetres with sub-pixel accuracy. OpenCV's own drawing functions round to 1/16 px.

The share of a pixel that a shape covers is weighted with a hat function: a tent two pixels wide, centred on the pixel.
Hat functions keep the area and the centroid of a shape exact at any sub-pixel position. The plain area inside the
pixel's square would displace the centroid of a box of 12 px by up to 0.01 px.

A canvas covers a rectangle of the board. The outer corner of pixel (0, 0) is at `origin_mm`. For each pixel a canvas
holds a grey value and the share of metal, because the brightness of metal depends on the LED pattern.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

Plane = NDArray[np.floating[Any]]
Bytes = NDArray[np.uint8]

_FINE = 4
"""Number of samples per pixel and axis for the edges of small rotated boxes."""
_BAND_PX = 64
_LARGE_PX = 64
"""Half diagonal in px above which a rotated box is sampled once per pixel: errors average out along long edges."""


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture that is being painted: grey values and shares of metal, (h, w) float32 each."""

    grey: Plane
    metal: Plane
    origin_mm: tuple[float, float]
    px_per_mm: float

    @classmethod
    def blank(
        cls, origin_mm: tuple[float, float], size_mm: tuple[float, float], px_per_mm: float, grey: float
    ) -> Canvas:
        """Create a canvas of one grey value, without metal, with its size rounded up to whole pixels."""
        w, h = (math.ceil(s * px_per_mm) for s in size_mm)
        return cls(np.full((h, w), grey, np.float32), np.zeros((h, w), np.float32), origin_mm, px_per_mm)

    def to_px(self, places_mm: Floats) -> Floats:
        """Convert board coordinates (..., 2) in mm to pixels (..., 2). Pixel centres have integer coordinates."""
        return np.asarray((np.asarray(places_mm) - self.origin_mm) * self.px_per_mm - 0.5)

    def box(
        self,
        place: tuple[float, float],
        size: tuple[float, float],
        grey: float,
        *,
        metal: float = 0.0,
        turned_deg: float = 0.0,
    ) -> None:
        """Paint a rectangle of size (w, h) mm centred at `place`, rotated counter-clockwise as seen by the camera."""
        window, coverage = self._box_coverage(place, size, turned_deg)
        self._blend(window, coverage, grey, metal)

    def disc(self, place: tuple[float, float], diameter: float, grey: float, *, metal: float = 0.0) -> None:
        """Paint a disc with its centre at `place`. Place and diameter are in mm."""
        (x, y), r = self.to_px(np.array(place)), diameter / 2 * self.px_per_mm
        window, u, v = self._window(x, y, r, r)
        if u.size and v.size:
            self._blend(window, _step(r - np.hypot(u[None], v[:, None])), grey, metal)

    def cross(self, place: tuple[float, float], size: float, width: float, grey: float, *, metal: float = 0.0) -> None:
        """Paint an upright cross with its centre at `place`: `size` mm from tip to tip, with arms `width` mm wide."""
        window, across = self._box_coverage(place, (size, width), 0.0, reach=size)
        _, along = self._box_coverage(place, (width, size), 0.0, reach=size)
        _, shared = self._box_coverage(place, (width, width), 0.0, reach=size)
        # The square in the middle belongs to both arms and must be counted only once.
        self._blend(window, across + along - shared, grey, metal)

    def strokes(
        self, lines_mm: list[Floats], width_mm: float, grey: float, *, metal: float = 0.0, closed: bool = False
    ) -> None:
        """Paint polylines of one width with round ends.

        The centre lines are exact to 1/16 px. Anti-aliasing makes the lines 1.7 px wider than `width_mm`.
        """
        if not lines_mm:
            return
        mask = np.zeros(self.grey.shape, np.uint8)
        # The last argument of polylines (4) is the number of fractional bits: 1/16 px.
        points = [np.round(self.to_px(line) * 16).astype(np.int32) for line in lines_mm]
        thickness = max(round(width_mm * self.px_per_mm), 1)
        cv2.polylines(mask, points, closed, 255, thickness, cv2.LINE_AA, 4)
        self._blend(np.s_[:, :], mask, grey, metal)

    def text(
        self, text: str, place: tuple[float, float], height_mm: float, grey: float, turned_deg: float = 0.0
    ) -> None:
        """Paint text with its centre at `place`, rotated counter-clockwise.

        `height_mm` is the height of OpenCV's text box. Capital letters are three quarters of that height.
        """
        mask = _text_mask(text, max(round(height_mm * self.px_per_mm), 5))
        x, y = self.to_px(np.array(place))
        reach = math.hypot(*mask.shape) / 2 + 1
        window, u, v = self._window(x, y, reach, reach)
        if not (u.size and v.size):
            return
        a = math.radians(turned_deg)
        c, s = math.cos(a), math.sin(a)
        middle_x, middle_y = (mask.shape[1] - 1) / 2, (mask.shape[0] - 1) / 2
        map_x = (c * u[None] - s * v[:, None] + middle_x).astype(np.float32)
        map_y = (s * u[None] + c * v[:, None] + middle_y).astype(np.float32)
        coverage = cv2.remap(mask, map_x, map_y, cv2.INTER_LINEAR, borderValue=0)
        self._blend(window, coverage.astype(np.float32) / 255, grey, 0.0)

    def _box_coverage(
        self, place: tuple[float, float], size: tuple[float, float], turned_deg: float, reach: float | None = None
    ) -> tuple[tuple[slice, slice], Plane]:
        """Return the pixels that a box can touch, or a square of `reach` mm, and the share it covers of each."""
        w, h = size
        quarter = turned_deg % 90 == 0
        if quarter and turned_deg % 180 == 90:
            w, h = h, w
        w, h = w * self.px_per_mm, h * self.px_per_mm
        x, y = self.to_px(np.array(place))
        if quarter:
            half = (w / 2, h / 2) if reach is None else (reach * self.px_per_mm / 2,) * 2
            window, u, v = self._window(x, y, *half)
            return window, _span(v, h)[:, None] * _span(u, w)[None]
        radius = math.hypot(w, h) / 2
        window, u, v = self._window(x, y, radius, radius)
        a = math.radians(turned_deg)
        c, s = math.cos(a), math.sin(a)
        # Supersampling a large rotated box would need 16 times the memory of its window.
        if radius > _LARGE_PX:
            along, across = c * u[None] - s * v[:, None], s * u[None] + c * v[:, None]
            return window, np.asarray(_span(along, w) * _span(across, h))
        (fine_u, hats_u), (fine_v, hats_v) = _supersample(u), _supersample(v)
        along, across = c * fine_u[None] - s * fine_v[:, None], s * fine_u[None] + c * fine_v[:, None]
        inside = _span(along * _FINE, w * _FINE) * _span(across * _FINE, h * _FINE)
        return window, np.asarray(hats_v @ inside @ hats_u.T)

    def _window(self, x: float, y: float, half_w: float, half_h: float) -> tuple[tuple[slice, slice], Plane, Plane]:
        """Return the window of pixels that a shape can touch, and their x and y offsets from its centre (x, y)."""
        h, w = self.grey.shape
        x0, x1 = max(math.floor(x - half_w - 1), 0), min(math.ceil(x + half_w + 2), w)
        y0, y1 = max(math.floor(y - half_h - 1), 0), min(math.ceil(y + half_h + 2), h)
        u, v = np.arange(x0, max(x1, x0)) - x, np.arange(y0, max(y1, y0)) - y
        return np.s_[y0 : max(y1, y0), x0 : max(x1, x0)], u.astype(np.float32), v.astype(np.float32)

    def _blend(self, window: tuple[slice, slice], coverage: Plane | Bytes, grey: float, metal: float) -> None:
        """Blend a grey value and a share of metal into a window, by weights of 0 to 1, or 0 to 255 if 8-bit."""
        for band in bands(len(coverage)):
            share = coverage[band]
            if share.dtype == np.uint8:
                share = share.astype(np.float32) / 255
            for plane, value in ((self.grey, grey), (self.metal, metal)):
                part = plane[window][band]
                part += (np.float32(value) - part) * share


def _supersample(offset: Plane) -> tuple[Plane, Plane]:
    """Return finer offsets of n pixels, and a matrix (n, k) of hat functions that sums fine samples to pixels."""
    if not offset.size:
        return offset, np.zeros((0, 0), np.float32)
    fine = np.arange((len(offset) + 1) * _FINE + 1, dtype=np.float32) / _FINE - 1
    hats = np.clip(1 - np.abs(fine[None] - np.arange(len(offset))[:, None]), 0, 1) / _FINE
    return fine + offset[0], np.asarray(hats, np.float32)


def bands(rows: int) -> Iterator[slice]:
    """Split the pixel rows of an image into bands, so that temporary arrays are small.

    A band fits into the processor's cache, and large boards fit into memory.
    """
    return (slice(k, k + _BAND_PX) for k in range(0, rows, _BAND_PX))


def to_bytes(plane: Plane, gain: float = 1.0) -> Bytes:
    """Multiply an image by a gain, round it and clip it to 8 bits. The returned image is read-only."""
    result = np.empty(plane.shape, np.uint8)
    for band in bands(len(plane)):
        result[band] = np.clip(np.rint(plane[band] * np.float32(gain)), 0, 255)
    # Threads that render frames share the textures, so a write would change other frames.
    result.setflags(write=False)
    return result


def _step(depth: Plane) -> Plane:
    """Return the integral of a hat function of half width 1, from minus infinity to `depth`."""
    t = np.clip(depth, -1, 1)
    return np.asarray(np.where(t < 0, (t + 1) ** 2 / 2, 1 - (1 - t) ** 2 / 2), np.float32)


def _span(offset: Plane, width: float) -> Plane:
    """Compute which share of a hat function at each offset lies in an interval of `width` about 0."""
    return np.asarray(_step(offset + width / 2) - _step(offset - width / 2))


@lru_cache(maxsize=2048)
def _text_mask(text: str, height_px: int) -> Bytes:
    """Return a mask of text (255 on the letters) whose text box, as OpenCV measures it, is `height_px` tall."""
    # OpenCV takes a font scale and no height, so the height of a capital is measured at a trial scale.
    font, trial = cv2.FONT_HERSHEY_SIMPLEX, 2.0
    (_, tall), _ = cv2.getTextSize("H", font, trial, 1)
    scale = trial * height_px / max(tall, 1)
    weight = max(round(height_px / 8), 1)
    (w, h), below = cv2.getTextSize(text, font, scale, weight)
    mask = np.zeros((h + below + 8, w + 8), np.uint8)
    cv2.putText(mask, text, (4, h + 4), font, scale, 255, weight, cv2.LINE_AA)
    mask.setflags(write=False)
    return mask

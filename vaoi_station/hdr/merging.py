"""Merge the frames that show one component or region: m_v pictures, each of all exposures, and one of all frames.

Every frame is turned into radiance where the picture needs it, resampled into the picture (equation 22), and added with
the inverse of its noise variance as weight. All pictures of one component lie on the same grid and in the same plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.photometry import FieldMaps, Radiance, Taken
from vaoi_station.photometry.noise import FULL_SCALE, Floats32
from vaoi_station.rendering import View

_SHARPENING_PX2 = 0.25
"""Second moment, px², by which frames are sharpened along each axis before they are interpolated.

Bilinear interpolation blurs by f (1 − f) at a fraction f of a pixel: 1/4 at most, 1/6 on average. Beside bright metal
this blur would add light to dark places: by several per cent over two decades of radiance.
"""
_TAPS = np.array([-_SHARPENING_PX2 / 2, 1 + _SHARPENING_PX2, -_SHARPENING_PX2 / 2], np.float32)
_MARGIN_PX = 4
"""Pixels around the used part of a frame, for interpolation and sharpening."""
_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_ONE = np.ones((1, 1), np.float32)
_GRID = 12
"""Points per side of the grid on which coverage is compared."""
_COMPLETE = 0.995
"""Least share of the places of an exposure that a group must show by this exposure, to be complete."""
_TWICE = 2
_OFTEN = 0.8
"""Least share of the places that a group must show by two frames of the longest exposure, where there are two.

They halve the noise variance of dark places, which only the longest exposure shows well."""
_EXPOSURES_DIFFER = 1.25
"""Least factor between two exposures · gains that count as different."""


@dataclass(frozen=True, eq=False)
class Exposed:
    """A view with what its frame was taken with. Frames are read when they are needed."""

    view: View
    taken: Taken
    maps: FieldMaps
    frame_size: tuple[int, int]
    """Width and height of the frame in px."""
    pixels: Callable[[], NDArray[Any]]

    @property
    def scale(self) -> float:
        """Exposure in µs times gain."""
        return self.taken.exposure_us * self.taken.gain

    @property
    def key(self) -> tuple[int, int]:
        """Camera and row of the frame."""
        return self.view.camera, self.view.row


@dataclass(frozen=True, eq=False)
class MergedPicture:
    """A picture in linear radiance, merged of one or more frames."""

    views: tuple[View, ...]
    """The views it was merged of, best first."""
    exposures: int
    """Number of different exposures among them."""
    value: Floats32
    """(h, w) radiance in grey levels per µs at gain 1; NaN where no frame gives a valid value."""
    weight: Floats32
    """(h, w) inverse variance of `value`; 0 where it is NaN."""

    @property
    def sigma(self) -> Floats32:
        """Standard deviation (h, w) of the radiance by noise; infinite where there is no value."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.sqrt(self.weight), dtype=np.float32)

    @property
    def radiance(self) -> Radiance:
        """The picture with its standard deviation and validity."""
        return Radiance(self.value, self.sigma, self.weight > 0)

    @property
    def holes(self) -> float:
        """Share of the picture without a value."""
        return float((self.weight == 0).mean())


def merge_views(views: Sequence[Exposed], *, groups: bool = True) -> list[MergedPicture]:
    """Merge all views of one component, which have one size.

    Args:
        views: the views, best first; at least one.
        groups: also return the paper's m_v pictures, one for each group of `exposure_groups`.

    Returns:
        The pictures of the groups in the order of their rows, and last the picture of all views.
    """
    parts = [*(exposure_groups(views) if groups else ()), list(views)]
    shape = views[0].view.height, views[0].view.width
    sums = [(np.zeros(shape, np.float32), np.zeros(shape, np.float32)) for _ in parts]
    for view in views:
        # Groups share frames, and each frame is resampled once.
        _add(view, [sums[n] for n, part in enumerate(parts) if view in part])
    return [_picture(part, *total) for part, total in zip(parts, sums, strict=True)]


def exposure_groups(views: Sequence[Exposed]) -> list[list[Exposed]]:
    """Choose the frames of the m_v pictures: for each row, it and the rows after it until the group is complete.

    A group is complete when every exposure shows all that it shows in any frame: then no place of the picture is left
    to an exposure that is too short or too long for it. Rows whose group would not become complete start none. If no
    group is complete, all views are one group.
    """
    levels = distinct_exposures(views)
    masks = {id(v): _shown(v) for v in views}
    levels_of = {id(v): int(np.searchsorted(levels, v.scale, side="right")) - 1 for v in views}
    whole = np.zeros((len(levels), _GRID**2), np.int_)
    for v in views:
        whole[levels_of[id(v)]] += masks[id(v)]
    covered, twice = whole > 0, np.minimum(whole[-1], _TWICE).sum()
    if not covered.any():
        return [list(views)]
    rows = sorted({v.view.row for v in views})
    groups: list[list[Exposed]] = []
    for n in range(len(rows)):
        group: list[Exposed] = []
        seen = np.zeros_like(whole)
        for row in rows[n:]:
            for v in views:
                if v.view.row == row:
                    group.append(v)
                    seen[levels_of[id(v)]] += masks[id(v)]
            complete = (seen > 0)[covered].mean() >= _COMPLETE
            if complete and np.minimum(seen[-1], _TWICE).sum() >= _OFTEN * twice:
                groups.append(group)
                break
    return groups or [list(views)]


def _shown(exposed: Exposed) -> NDArray[np.bool_]:
    """Return which points of a grid over the picture a frame shows, (k,)."""
    view = exposed.view
    x, y = (np.linspace(0, n - 1, _GRID) for n in (view.width, view.height))
    at = apply(view.matrix, np.stack(np.meshgrid(x, y), -1).reshape(-1, 2))
    return np.asarray(((at >= 1) & (at <= np.array(exposed.frame_size) - 2)).all(1))


def distinct_exposures(views: Sequence[Exposed]) -> list[float]:
    """Return the different exposures · gains of views, increasing; similar ones count once."""
    found: list[float] = []
    for scale in sorted(v.scale for v in views):
        if not found or scale > found[-1] * _EXPOSURES_DIFFER:
            found.append(scale)
    return found


def _add(exposed: Exposed, sums: Sequence[tuple[Floats32, Floats32]]) -> None:
    """Add a frame to the sums of several merges: of radiance weighted by 1/σ² (h, w), and of the weights (h, w)."""
    from vaoi_station.hdr.kernels import accumulate

    noise, value, scales = exposed.maps.noise, _warped(exposed), _block_scales(exposed)
    for total, weight in sums:
        accumulate(value, scales, (noise.read**2, noise.shot * exposed.taken.gain), total, weight)


def _picture(views: Sequence[Exposed], total: Floats32, weight: Floats32) -> MergedPicture:
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.asarray(total / weight, dtype=np.float32)
    return MergedPicture(tuple(v.view for v in views), len(distinct_exposures(views)), value, weight)


def _warped(exposed: Exposed) -> Floats32:
    """Resample one frame into the picture, as radiance (h, w); NaN outside the frame and beside saturated pixels."""
    from vaoi_station.hdr.kernels import linearise

    view, pixels = exposed.view, exposed.pixels()
    if pixels.ndim == 3:
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    box = _used_part(view, pixels.shape)
    if box is None:
        return np.full((view.height, view.width), np.nan, np.float32)
    maps = exposed.maps.part(*box)
    flat = _ONE if maps.flat is None else maps.flat
    dark = np.full((1, 1), maps.dark, np.float32) if isinstance(maps.dark, float) else maps.dark
    full = FULL_SCALE if pixels.dtype == np.uint8 else 65535.0
    source = np.empty((box[0].stop - box[0].start, box[1].stop - box[1].start), np.float32)
    linearise(pixels[box], dark, flat, (FULL_SCALE / full, 1 / exposed.scale, full), source)
    # The taps turn NaN into NaN: the eight neighbours of a saturated pixel are out as well.
    source = cv2.sepFilter2D(source, -1, _TAPS, _TAPS, borderType=cv2.BORDER_REPLICATE)
    left, top = box[1].start, box[0].start
    nan = (float("nan"),) * 4
    if not view.tiles:
        size = (view.width, view.height)
        return np.asarray(
            cv2.warpPerspective(source, _shifted(view.matrix, left, top), size, flags=_FLAGS, borderValue=nan)
        )
    out = np.empty((view.height, view.width), np.float32)
    for t in view.tiles:
        size = (t.x1 - t.x0, t.y1 - t.y0)
        out[t.y0 : t.y1, t.x0 : t.x1] = cv2.warpPerspective(
            source, _shifted(t.matrix, left, top), size, flags=_FLAGS, borderValue=nan
        )
    return out


def _shifted(matrix: Floats, left: int, top: int) -> Floats:
    """Return a matrix to the frame as one to the part of the frame that begins at (left, top)."""
    out = matrix.copy()
    out[0] -= left * matrix[2]
    out[1] -= top * matrix[2]
    return out


def _used_part(view: View, shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Return the rows and columns of the frame that the picture needs; None if it needs none."""
    parts = [(t.matrix, t.x1 - t.x0 - 1, t.y1 - t.y0 - 1) for t in view.tiles]
    points = [
        _point(m.tolist(), x, y)
        for m, right, bottom in parts or [(view.matrix, view.width - 1, view.height - 1)]
        for x in (0, right)
        for y in (0, bottom)
    ]
    xs, ys = zip(*points, strict=True)
    x0, y0 = max(math.floor(min(xs)) - _MARGIN_PX, 0), max(math.floor(min(ys)) - _MARGIN_PX, 0)
    x1, y1 = math.ceil(max(xs)) + _MARGIN_PX + 1, math.ceil(max(ys)) + _MARGIN_PX + 1
    x1, y1 = min(x1, shape[1]), min(y1, shape[0])
    return None if x1 <= x0 or y1 <= y0 else (slice(y0, y1), slice(x0, x1))


def _point(matrix: list[list[float]], x: float, y: float) -> tuple[float, float]:
    """Project one point; for few points this is ten times as fast as arrays."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    w = g * x + h * y + i
    return (a * x + b * y + c) / w, (d * x + e * y + f) / w


def _block_scales(exposed: Exposed) -> NDArray[np.float64]:
    """Return the grey levels per unit of radiance for each block of the picture, (rows, columns)."""
    from vaoi_station.hdr.kernels import BLOCK_SHIFT

    view, side, flat = exposed.view, 1 << BLOCK_SHIFT, exposed.maps.flat
    rows, columns = -(-view.height // side), -(-view.width // side)
    if flat is None:
        return np.full((rows, columns), exposed.scale)
    height, width = flat.shape
    matrix, found = view.matrix.tolist(), np.empty((rows, columns))
    for j in range(rows):
        for i in range(columns):
            x, y = _point(matrix, (i + 0.5) * view.width / columns, (j + 0.5) * view.height / rows)
            at = flat[min(max(int(y), 0), height - 1), min(max(int(x), 0), width - 1)]
            found[j, i] = max(float(at), 0.02) * exposed.scale
    return found

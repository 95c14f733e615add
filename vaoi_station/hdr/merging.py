"""Merge the frames that show one component or region: m_v pictures, each of all exposures, and one of all frames.

Every frame is turned into radiance where the picture needs it, resampled into the picture (equation 22), and added with
the inverse of its noise variance as weight. All pictures of one component lie on the same grid and in the same plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.photometry import FieldMaps, Radiance, Taken
from vaoi_station.photometry.noise import FULL_SCALE, Floats32
from vaoi_station.photometry.radiance import pixels_at_limit
from vaoi_station.rendering import View
from vaoi_station.rendering.view import Tile

if TYPE_CHECKING:
    from vaoi_station.hdr.kernels import Source

_MARGIN_PX = 4
"""Pixels around the used part of a frame, for interpolation and sharpening."""
_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
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


@dataclass(eq=False, slots=True)
class Exposed:
    """A view with what its frame was taken with. Frames are read when they are needed. It is not changed later."""

    # Not `frozen`, as views: `object.__setattr__` for every field would double the cost.

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
    deviation: Floats32 | None
    """(h, w) standard deviation of each pixel of `value` by noise, infinite where it is NaN; None if not wanted.

    Sharpening and interpolation are in it. They also make neighbouring pixels depend on each other.
    """

    @property
    def sigma(self) -> Floats32:
        """The standard deviation of a picture that was merged with `sigma`."""
        assert self.deviation is not None, "merged without sigma"
        return self.deviation

    @property
    def radiance(self) -> Radiance:
        """The picture with its standard deviation and validity."""
        return Radiance(self.value, self.sigma, np.isfinite(self.value))

    @property
    def holes(self) -> float:
        """Share of the picture without a value."""
        return float(np.isnan(self.value).mean())


def merge_views(views: Sequence[Exposed], *, groups: bool = True, sigma: bool = True) -> list[MergedPicture]:
    """Merge all views of one component, which have one size.

    Args:
        views: the views, best first; at least one.
        groups: also return the paper's m_v pictures, one for each group of `exposure_groups`.
        sigma: also compute the standard deviation of every pixel, which takes a third of the time more.

    Returns:
        The pictures of the groups in the order of their rows, and last the picture of all views.
    """
    from vaoi_station.hdr.kernels import mean

    parts = [*(exposure_groups(views) if groups else ()), views]
    first, every = views[0].view, np.zeros(1, np.int64)
    sums = np.zeros((3 if sigma else 2, len(parts), first.height, first.width), np.float32)
    for view in views:
        # Groups share frames, and each frame is resampled once.
        mine = np.array([n for n, part in enumerate(parts) if part is views or view in part]) if groups else every
        _add(view, mine, sums)
    found = []
    for n, part in enumerate(parts):
        value = np.empty((first.height, first.width), np.float32)
        mean(sums[0, n], sums[1, n], value)
        deviation = _deviation(sums[1, n], sums[2, n]) if sigma else None
        found.append(MergedPicture(tuple(v.view for v in part), len(distinct_exposures(part)), value, deviation))
    return found


def _deviation(weight: Floats32, noise: Floats32) -> Floats32:
    """Return the standard deviation of means: their variance is Σ(weight² · variance) / (Σ weight)²."""
    found = np.full(weight.shape, np.inf, np.float32)
    return np.divide(np.sqrt(noise), weight, out=found, where=weight > 0)


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


def _add(exposed: Exposed, groups: NDArray[np.int64], sums: Floats32) -> None:
    """Add a frame to the sums of several merges, those of `add_shifted`."""
    from vaoi_station.hdr.kernels import accumulate, add_shifted

    view, source = exposed.view, _source(exposed)
    rest = []
    for tile in view.tiles or (Tile(0, 0, view.width, view.height, view.matrix),):
        x0, y0, x1, y1, matrix = tile
        if not add_shifted(source, matrix, (x0, y0, x1 - x0, y1 - y0), groups, sums):
            rest.append(tile)
    if rest:
        picture, scales = _warped(view, source, rest), _block_scales(view, source)
        unwanted = np.empty_like(sums[0, 0])
        for n in groups.tolist():
            own = sums[0, n], sums[1, n], sums[2, n] if len(sums) > 2 else unwanted
            accumulate(picture, scales, (source.read_variance, source.shot_variance), own)


def _source(exposed: Exposed) -> Source:
    """Return the frame of a view for the compiled functions."""
    from vaoi_station.hdr.kernels import Source, by_depth

    pixels, maps, taken = exposed.pixels(), exposed.maps, exposed.taken
    full = FULL_SCALE if pixels.dtype == np.uint8 else 65535.0
    if pixels.ndim == 3:
        # Luminance hides that one channel is saturated, so it is marked as saturated as well.
        at_limit = pixels_at_limit(pixels)
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
        pixels[at_limit] = full
    grey = by_depth(np.ascontiguousarray(pixels))
    (flat, dark), noise = maps.arrays, maps.noise
    return Source(*grey, dark, flat, FULL_SCALE / full, full, exposed.scale, noise.read**2, noise.shot * taken.gain)


def _warped(view: View, source: Source, tiles: Sequence[Tile]) -> tuple[Floats32, Floats32]:
    """Resample a frame into tiles of a picture, as radiance (h, w), with OpenCV, and with the factor of its variance.

    The radiance is NaN elsewhere, outside the frame and beside saturated pixels.
    """
    from vaoi_station.hdr.kernels import SHARPENING_PX2, linearise, noise_factors

    shape = view.height, view.width
    out, factors = np.full(shape, np.nan, np.float32), np.ones(shape, np.float32)
    taps = np.array([-SHARPENING_PX2 / 2, 1 + SHARPENING_PX2, -SHARPENING_PX2 / 2], np.float32)
    for x0, y0, x1, y1, matrix in tiles:
        box = _used_part(matrix, (x1 - x0, y1 - y0), max(source.pixels.shape, source.deep.shape))
        if box is None:
            continue
        # Numba compiles a separate version for parts of arrays.
        part_factors = np.empty((y1 - y0, x1 - x0), np.float32)
        noise_factors(matrix, part_factors)
        factors[y0:y1, x0:x1] = part_factors
        left, top, right, bottom = box
        part = np.empty((bottom - top, right - left), np.float32)
        linearise(source, box, part)
        # The taps turn NaN into NaN: the eight neighbours of a saturated pixel are out as well.
        part = cv2.sepFilter2D(part, -1, taps, taps, borderType=cv2.BORDER_REPLICATE)
        nan = (float("nan"),) * 4
        out[y0:y1, x0:x1] = cv2.warpPerspective(
            part, _shifted(matrix, left, top), (x1 - x0, y1 - y0), flags=_FLAGS, borderValue=nan
        )
    return out, factors


def _shifted(matrix: Floats, left: int, top: int) -> Floats:
    """Return a matrix to the frame as one to the part of the frame that begins at (left, top)."""
    out = matrix.copy()
    out[0] -= left * matrix[2]
    out[1] -= top * matrix[2]
    return out


def _used_part(matrix: Floats, size: tuple[int, int], shape: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """Return the part of a frame, first column and row and those after the last, that a picture needs; None if none."""
    rows = matrix.tolist()
    xs, ys = zip(*(_point(rows, x, y) for x in (0, size[0] - 1) for y in (0, size[1] - 1)), strict=True)
    x0, y0 = max(math.floor(min(xs)) - _MARGIN_PX, 0), max(math.floor(min(ys)) - _MARGIN_PX, 0)
    x1, y1 = math.ceil(max(xs)) + _MARGIN_PX + 1, math.ceil(max(ys)) + _MARGIN_PX + 1
    x1, y1 = min(x1, shape[1]), min(y1, shape[0])
    return None if x1 <= x0 or y1 <= y0 else (x0, y0, x1, y1)


def _point(matrix: list[list[float]], x: float, y: float) -> tuple[float, float]:
    """Project one point; for few points this is ten times as fast as arrays."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    w = g * x + h * y + i
    return (a * x + b * y + c) / w, (d * x + e * y + f) / w


def _block_scales(view: View, source: Source) -> NDArray[np.float64]:
    """Return the grey levels per unit of radiance for each block of the picture, (rows, columns)."""
    from vaoi_station.hdr.kernels import BLOCK_SHIFT

    side = 1 << BLOCK_SHIFT
    rows, columns = -(-view.height // side), -(-view.width // side)
    height, width = source.flat.shape
    matrix, found = view.matrix.tolist(), np.empty((rows, columns))
    for j in range(rows):
        for i in range(columns):
            right, bottom = min((i + 1) * side, view.width), min((j + 1) * side, view.height)
            x, y = _point(matrix, (i * side + right) // 2, (j * side + bottom) // 2)
            at = source.flat[min(max(int(y), 0), height - 1), min(max(int(x), 0), width - 1)]
            found[j, i] = max(float(at), 0.02) * source.exposure
    return found

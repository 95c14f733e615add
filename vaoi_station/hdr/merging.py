"""Merge the frames that show one component or region: m_v pictures, each of all exposures, and one of all frames.

Every frame is turned into radiance where the picture needs it, resampled into the picture (equation 22), and added with
the inverse of its noise variance as weight. All pictures of one component lie on the same grid and in the same plane.
Bodies in the picture of a region are merged in the planes of their tops.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.errors import InputError
from vaoi_station.geometry.homographies import of_part
from vaoi_station.geometry.polygon import pixels_inside
from vaoi_station.geometry.resampling import chord, chord_px, run_at
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.model.stitch_result import known_height_mm
from vaoi_station.photometry import FieldMaps, Taken
from vaoi_station.photometry.noise import FULL_SCALE, Floats32, pixels_at_limit
from vaoi_station.rendering import Framing, View, ViewCalculator
from vaoi_station.rendering.views import MOST_PIXELS, Tile

REGION = "region"
"""Name of the picture of a region."""
LEAST_COVERAGE = 0.02
"""Least share of a component that a frame must show to be merged, if the caller does not choose another."""


def views_on_top(
    calculator: ViewCalculator,
    component: Component,
    height_mm: float,
    *,
    px_per_mm: float | None = None,
    min_coverage: float | None = None,
) -> tuple[View, ...]:
    """Compute the views of a component in the plane of its top, in which its body lies still from view to view."""
    least = LEAST_COVERAGE if min_coverage is None else max(min_coverage, 1e-9)
    return calculator.compute(
        component,
        px_per_mm=px_per_mm,
        min_coverage=least,
        framing=Framing(plane="top") if height_mm else None,
        height_mm=height_mm or None,
    )


def region_component(
    corners: Sequence[float], board_type: BoardType, px_per_mm: float, where: str = "--region"
) -> Component:
    """Return a region of the board as a component without a body.

    Raises:
        InputError: the region has no area, does not touch the board, or is too large.
    """
    x0, y0, x1, y1 = (float(v) for v in corners)
    shown, unit = f"{x0:g} {y0:g} {x1:g} {y1:g}", board_type.unit
    if not all(map(math.isfinite, (x0, y0, x1, y1))) or x0 >= x1 or y0 >= y1:
        raise InputError.field(
            where, "X0 Y0 X1 Y1", shown, f"numbers with X0 < X1 and Y0 < Y1, in CAD coordinates ({unit})"
        )
    low, high = (corner.tolist() for corner in board_type.extent())
    if x1 <= low[0] or y1 <= low[1] or x0 >= high[0] or y0 >= high[1]:
        raise InputError.field(
            where,
            "X0 Y0 X1 Y1",
            shown,
            f"on the board, which reaches from {low[0]:g} {low[1]:g} to {high[0]:g} {high[1]:g} ({unit}, CAD)",
        )
    mm = board_type.mm_per_unit
    pixels = (x1 - x0) * (y1 - y0) * (mm * px_per_mm) ** 2
    if pixels > MOST_PIXELS:
        most = px_per_mm * math.sqrt(MOST_PIXELS / pixels)
        raise InputError(
            f"{where}: {shown} is {(x1 - x0) * mm:.1f} × {(y1 - y0) * mm:.1f} mm, {pixels / 1e6:.0f} megapixels at "
            f"{px_per_mm:.4g} px/mm, but the limit is {MOST_PIXELS / 1e6:.0f}.",
            action=f"Ask for a smaller region, or for at most {math.floor(most * 10) / 10:g} px/mm.",
        )
    return Component(ref=REGION, center=((x0 + x1) / 2, (y0 + y1) / 2), width=x1 - x0, height=y1 - y0)


_PART_PX = 256
"""Longest side of the parts in which the flat field counts as constant for the noise."""
_LEAST_FLAT = 0.02
"""Flat field below which a pixel sees nothing."""
_SHARPENING_PX2 = 0.25
"""Second moment, px², by which frames are sharpened along each axis before they are interpolated.

Bilinear interpolation blurs by f (1 − f) at a fraction f of a pixel: 1/4 at most, 1/6 on average. Beside bright metal
this blur would add light to dark places: by several per cent over two decades of radiance.
"""
_SIDE = -_SHARPENING_PX2 / 2
"""Weight of the neighbours; that of the pixel itself is 1 − 2 · `_SIDE`."""
_MOST_NOISE = (1 - 2 * _SIDE) ** 2 + 2 * _SIDE**2
"""Factor by which sharpening multiplies the variance of noise along one axis."""
_LESS_NOISE = 2 * _MOST_NOISE - 4 * _SIDE * (1 - 2 * _SIDE)
"""Interpolation at a fraction f of a pixel reduces this factor by `_LESS_NOISE` · f (1 − f): squares of the taps of
both, convolved."""
_EVEN = np.ones((1, 1), np.float32)
"""Stands for a flat field that is 1 everywhere."""
_MARGIN_PX = 4
"""Pixels around the used part of a frame, for interpolation and sharpening."""
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
    parts = [*(exposure_groups(views) if groups else ()), views]
    first = views[0].view
    sums = np.zeros((3 if sigma else 2, len(parts), first.height, first.width), np.float32)
    for view in views:
        # Groups share frames, and each frame is resampled once.
        _add(view, [n for n, part in enumerate(parts) if part is views or view in part], sums)
    found = []
    for n, part in enumerate(parts):
        total, weight = sums[:2, n]
        # NaN where there is no weight.
        with np.errstate(invalid="ignore"):
            value = total / weight
            # The variance of a mean is Σ(weight² · variance) / (Σ weight)².
            spread = np.nan_to_num(np.sqrt(sums[2, n]) / weight, nan=np.inf, posinf=np.inf) if sigma else None
        found.append(MergedPicture(tuple(v.view for v in part), len(distinct_exposures(part)), value, spread))
    return found


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


def _add(exposed: Exposed, groups: Sequence[int], sums: Floats32) -> None:
    """Add a frame to the sums (2 or 3, n, h, w) of several merges.

    They are the sums of value / variance, of 1 / variance, and of noise factor / variance.
    """
    boxes, matrices = _parts(exposed.view)
    pixels, maps = exposed.pixels(), exposed.maps
    rows, columns = pixels.shape[:2]
    scales, low_x, low_y, high_x, high_y = [], columns, rows, 0, 0
    # Plain numbers: numpy takes ten times as long for so few.
    for (x0, y0, x1, y1), m in zip(boxes.tolist(), matrices.tolist(), strict=True):
        right, bottom = x1 - x0 - 0.5, y1 - y0 - 0.5
        places = ((-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom), ((x1 - x0) // 2, (y1 - y0) // 2))
        (ax, ay, aw), (bx, by, bw), (cx, cy, cw) = m
        at = [
            ((ax * x + ay * y + aw) / w, (bx * x + by * y + bw) / w)
            for x, y, w in ((x, y, cx * x + cy * y + cw) for x, y in places)
        ]
        across, down = zip(*at, strict=True)
        low_x, low_y = min(low_x, int(min(across)) - _MARGIN_PX), min(low_y, int(min(down)) - _MARGIN_PX)
        high_x, high_y = max(high_x, int(max(across)) + _MARGIN_PX), max(high_y, int(max(down)) + _MARGIN_PX)
        # Over a part the flat field counts as constant for the noise: it changes by a few per cent.
        x, y = min(max(int(across[4]), 0), columns - 1), min(max(int(down[4]), 0), rows - 1)
        scales.append(exposed.scale * (1.0 if maps.flat is None else max(float(maps.flat[y, x]), _LEAST_FLAT)))
    x0, y0, x1, y1 = max(low_x, 0), max(low_y, 0), min(high_x, columns), min(high_y, rows)
    if x1 <= x0 or y1 <= y0:
        return
    grey = pixels[y0:y1, x0:x1]
    full = int(np.iinfo(grey.dtype).max)
    if grey.ndim == 3:
        # Luminance hides that one channel is saturated, so it is marked as saturated as well.
        at_limit = pixels_at_limit(grey)
        grey = np.asarray(cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY))
        grey[at_limit] = full
    # NaN where pixels are saturated.
    value = grey.astype(np.float32)
    if cv2.minMaxLoc(grey)[1] >= full:
        value[grey >= full] = np.nan
    black = 0.0
    if isinstance(maps.dark, np.ndarray):
        value -= maps.dark[y0:y1, x0:x1] * np.float32(full / FULL_SCALE)
    else:
        black = float(maps.dark) * full / FULL_SCALE
    flat = _EVEN if maps.flat is None else maps.flat.view()
    # Numba compiles separate versions for writeable and read-only arrays.
    flat.flags.writeable = False
    noise, gain = maps.noise, exposed.taken.gain
    variance = np.array([(noise.shot * gain / scale, (noise.read / scale) ** 2) for scale in scales], np.float32)
    to_radiance = FULL_SCALE / full / exposed.scale
    part = _Part(value, x0, y0, black, to_radiance, flat)
    _accumulate(part, matrices, boxes, variance, np.array(groups), sums)


def _parts(view: View) -> tuple[NDArray[np.int64], Floats]:
    """Return the parts (k, 4) of a picture in which the noise is computed, and the matrices from their pixels."""
    if not view.tiles and max(view.width, view.height) <= _PART_PX:
        return np.array([(0, 0, view.width, view.height)]), np.ascontiguousarray(view.matrix[None])
    found = [
        (left, top, min(left + _PART_PX, x1), min(top + _PART_PX, y1), of_part(matrix, left - x0, top - y0))
        for x0, y0, x1, y1, matrix in view.tiles or (Tile(0, 0, view.width, view.height, view.matrix),)
        for top in range(y0, y1, _PART_PX)
        for left in range(x0, x1, _PART_PX)
    ]
    return np.array([part[:4] for part in found]), np.array([part[4] for part in found])


class _Part(NamedTuple):
    """A part of a frame, and how it becomes radiance."""

    grey: Floats32
    """(rows, columns) NaN counts as beside the frame."""
    left: int
    """Column and row of the first pixel in the frame."""
    top: int
    black: float
    """Grey level of darkness."""
    to_radiance: float
    """Radiance of a grey level where the flat field is 1."""
    flat: Floats32
    """Flat field of the frame, read-only; (1, 1) if it is 1 everywhere."""


@compiled
def _accumulate(  # noqa: PLR0912, PLR0915  (one compiled function; helpers would be compiled as well)
    part: _Part,
    matrices: Floats,
    boxes: NDArray[np.int64],
    variance: Floats32,
    groups: NDArray[np.int64],
    sums: Floats32,
) -> None:
    """Resample a part of a frame into k parts of a picture, and add it to the sums of several merges with its weights.

    Args:
        part: the part of the frame; `grey` is overwritten.
        matrices: (k, 3, 3) from pixels of the parts of the picture to those of the frame.
        boxes: (k, 4) first column and row of the parts in the picture, and those after their last.
        variance: (k, 2) variance per unit of radiance, and in darkness.
        groups: (g,) numbers of the merges.
        sums: (2 or 3, n, h, w).
    """
    grey, flat, left_px, top_px = part.grey, part.flat, part.left, part.top
    side, middle, scale, least = (
        np.float32(_SIDE),
        np.float32(1 - 2 * _SIDE),
        np.float32(part.to_radiance),
        np.float32(_LEAST_FLAT),
    )
    half, dark_level = np.empty_like(grey), np.float32(part.black)
    bare = np.empty(grey.shape[1] + 2, np.float32)
    last, even = grey.shape[1] - 1, len(flat) == 1
    # Sharpened along lines and then along columns; NaN spreads to the eight neighbours.
    for y in range(grey.shape[0]):
        line, out, field = grey[y], half[y], flat[0 if even else top_px + y, 0 if even else left_px :]
        if even:
            for x in range(last + 1):
                bare[x + 1] = (line[x] - dark_level) * scale
        else:
            for x in range(last + 1):
                share = field[x]
                bare[x + 1] = (line[x] - dark_level) * scale / share if share > least else np.float32(np.nan)
        bare[0], bare[last + 2] = bare[1], bare[last + 1]
        for x in range(last + 1):
            i = np.uint64(x)
            out[i] = middle * bare[i + np.uint64(1)] + side * (bare[i] + bare[i + np.uint64(2)])
    for y in range(grey.shape[0]):
        above, line, below, out = half[max(y - 1, 0)], half[y], half[min(y + 1, grey.shape[0] - 1)], grey[y]
        for x in range(last + 1):
            out[x] = middle * line[x] + side * (above[x] + below[x])
    rows, columns, source, target = grey.shape[0], grey.shape[1], grey.reshape(-1), sums.reshape(-1)
    nothing, one, most, less = np.float32(0), np.float32(1), np.float32(_MOST_NOISE), np.float32(_LESS_NOISE)
    plane, width = sums.shape[2] * sums.shape[3], sums.shape[3]
    pitch, beside = np.uint64(columns), np.uint64(1)
    line = np.empty((3, width), np.float32)
    total, weights, noise = line[0], line[1], line[2]
    for k in range(len(boxes)):
        m, x_first, y_first, x_end, y_end = matrices[k], boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]
        shot, dark = variance[k, 0], variance[k, 1]
        for y in range(y_end - y_first):
            for x in range(x_end - x_first):
                total[x] = weights[x] = noise[x] = nothing
            longest = chord_px(m, 0.0, y)
            for x0 in range(0, x_end - x_first, longest):
                length = min(longest, x_end - x_first - x0)
                u, v, du, dv = chord(m, x0, y, length)
                x = 0
                while x < length:
                    left, top, right, down, count = run_at(u + x * (du + 1), v + x * dv, du, dv, length - x)
                    left, top = left - left_px, top - top_px
                    before, after = max(-left, 0), min(count, columns - 1 - left)
                    if top < 0 or top + 1 >= rows:
                        after = before
                    ds, dt = np.float32(du), np.float32(dv)
                    s0, t0 = np.float32(right + du * before), np.float32(down + dv * before)
                    above, at = np.uint64(max(top * columns + left + before, 0)), np.uint64(x0 + x + before)
                    # Unsigned: the compiler uses vector registers only if no index can be negative.
                    for n in range(after - before):
                        i, steps = np.uint64(n), np.float32(np.int32(n))
                        upper, lower = above + i, above + i + pitch
                        s, t = s0 + ds * steps, t0 + dt * steps
                        a, c = source[upper], source[lower]
                        a += s * (source[upper + beside] - a)
                        c += s * (source[lower + beside] - c)
                        value = a + t * (c - a)
                        seen = value == value  # noqa: PLR0124  (NaN differs from itself)
                        # The weight depends so little on the pixel's own noise that dark noise gains no weight.
                        weight = one / (shot * max(value, nothing) + dark) if seen else nothing
                        total[at + i] = weight * value if seen else nothing
                        weights[at + i] = weight
                        noise[at + i] = weight * (most - less * s * (one - s)) * (most - less * t * (one - t))
                    x += count
            for group in groups:
                for sort in range(len(sums)):
                    at = np.uint64((sort * sums.shape[1] + group) * plane + (y_first + y) * width + x_first)
                    for n in range(x_end - x_first):
                        i = np.uint64(n)
                        target[at + i] += line[sort, i]


class Body(NamedTuple):
    """A body in the picture of a region."""

    part: Component
    """The rectangle of the picture around its footprint, as a region of the board."""
    height_mm: float
    box: tuple[int, int, int, int]
    """First column and row of that rectangle, and those after its last."""
    corners: Floats
    """(4, 2) corners of the footprint in pixels of the picture."""


def bodies_in(view: View, board_type: BoardType, stitch: Stitch) -> list[Body]:
    """Return the bodies of known height in the picture of a region, the highest last: it hides others.

    `view` is any view of the region.
    """
    heights = ((c, known_height_mm(c, board_type, stitch)) for c in board_type.components)
    raised = [(c, height_mm) for c, height_mm in heights if height_mm]
    footprints = stitch.footprints(board_type, [c for c, _ in raised])
    found = []
    for number, ((_, height_mm), footprint) in enumerate(zip(raised, footprints, strict=True)):
        corners = apply(view.crop_matrix, footprint)
        low = np.maximum(np.floor(corners.min(0) + 0.5), 0)
        high = np.minimum(np.ceil(corners.max(0) + 0.5), (view.width, view.height))
        if (high <= low).any():
            continue
        # Half a pixel around the centres of its pixels: the picture of this part lies on the grid of the region.
        ends = apply(view.cad_from_crop.matrix, np.stack([low, high]) - 0.5)
        (x, y), (width, height) = ends.mean(0).tolist(), np.abs(ends[1] - ends[0]).tolist()
        x0, y0, x1, y1 = (int(v) for v in (*low, *high))
        part = Component(ref=f"{REGION} {number}", center=(x, y), width=width, height=height)
        found.append(Body(part, height_mm, (x0, y0, x1, y1), corners))
    return sorted(found, key=lambda body: body.height_mm)


def views_of_bodies(
    calculator: ViewCalculator, bodies: Sequence[Body], px_per_mm: float
) -> list[tuple[Body, tuple[View, ...]]]:
    """Return the views of bodies in the planes of their tops, at the resolution of the region."""
    views = calculator.compute_all(
        [body.part for body in bodies],
        px_per_mm=px_per_mm,
        min_coverage=LEAST_COVERAGE,
        framing=Framing(plane="top"),
        heights_mm={body.part.address: body.height_mm for body in bodies},
    )
    return [(body, views[body.part.address]) for body in bodies]


def merge_region(
    views: Sequence[Exposed],
    bodies: Sequence[tuple[Body, Sequence[Exposed]]],
    *,
    groups: bool = True,
    sigma: bool = True,
) -> list[MergedPicture]:
    """Merge the views of a region as `merge_views` does, with its bodies in the planes of their tops.

    Each picture shows its bodies by the frames of which its ground is merged.
    """
    pictures = merge_views(views, groups=groups, sigma=sigma)
    for picture in pictures:
        frames = {(view.camera, view.row) for view in picture.views}
        for body, exposed in bodies:
            if mine := [e for e in exposed if e.key in frames]:
                _lay(picture, body, merge_views(mine, groups=False, sigma=sigma)[-1])
    return pictures


def _lay(picture: MergedPicture, body: Body, top: MergedPicture) -> None:
    """Replace the pixels of a footprint by those in the plane of the body's top, where it has a value."""
    x0, y0, x1, y1 = body.box
    if top.value.shape != (y1 - y0, x1 - x0):
        return  # a rounding of the sizes to whole pixels went the other way: its grid would be another one
    mask = pixels_inside(body.corners - (x0, y0), x1 - x0, y1 - y0) & np.isfinite(top.value)
    for whole, part in ((picture.value, top.value), (picture.deviation, top.deviation)):
        if whole is not None and part is not None:
            whole[y0:y1, x0:x1][mask] = part[mask]

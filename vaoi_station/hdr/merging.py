"""Merge the frames that show one component or region: m_v pictures, each of all exposures, and one of all frames.

Every frame is turned into radiance where the picture needs it, resampled into the picture (equation 22), and added with
the inverse of its noise variance as weight. All pictures of one component lie on the same grid and in the same plane.
Bodies in the picture of a region are merged in the planes of their tops.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.geometry.homographies import of_part, to_part
from vaoi_station.geometry.polygon import pixels_inside
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.model.stitch_result import known_height_mm
from vaoi_station.photometry import FieldMaps, Taken
from vaoi_station.photometry.noise import FULL_SCALE, Floats32, pixels_at_limit
from vaoi_station.rendering import Framing, View, ViewCalculator
from vaoi_station.rendering.views import MOST_PIXELS, Tile

if TYPE_CHECKING:
    from vaoi_station.hdr.kernels import Source


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
    """Compute the views of a component in the plane of its top, in which its body lies still from view to view.

    Args:
        calculator: calculator of the run's views.
        component: a component of the board type, or a region (`region_component`).
        height_mm: height of its top above the board; 0 for the plane of the board.
        px_per_mm: resolution; None for that of the cameras.
        min_coverage: least share of the component in a frame; None for hardly any, since frames complement each other.
    """
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

    Args:
        corners: x0, y0, x1, y1 in CAD coordinates.
        board_type: board type of the run.
        px_per_mm: resolution of the picture.
        where: how the caller names the region, for messages.

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
    from vaoi_station.hdr.kernels import add_shifted

    view, source = exposed.view, _source(exposed)
    for x0, y0, x1, y1, matrix in view.tiles or (Tile(0, 0, view.width, view.height, view.matrix),):
        place = x0, y0, x1 - x0, y1 - y0
        if not add_shifted(source, matrix, place, groups, sums):
            _add_turned(source, matrix, place, groups, sums)


def _add_turned(
    source: Source, matrix: Floats, place: tuple[int, int, int, int], groups: NDArray[np.int64], sums: Floats32
) -> None:
    """Do what `add_shifted` does with a frame that is turned or tilted in the picture, block by block with OpenCV."""
    from vaoi_station.hdr.kernels import BLOCK_SHIFT

    side, (x0, y0, width, height) = 1 << BLOCK_SHIFT, place
    for top in range(0, height, side):
        for left in range(0, width, side):
            right, bottom = min(left + side, width), min(top + side, height)
            part = sums[:, :, y0 + top : y0 + bottom, x0 + left : x0 + right]
            _add_block(source, of_part(matrix, left, top), groups, part)


def _add_block(source: Source, matrix: Floats, groups: NDArray[np.int64], sums: Floats32) -> None:
    """Add a frame to the sums (2 or 3, n, h, w) of a block; `matrix` is that from its pixels to those of the frame."""
    from vaoi_station.hdr.kernels import LEAST_FLAT, LESS_NOISE, MOST_NOISE, SHARPENING_PX2

    pixels, (height, width) = source.pixels if source.pixels.size else source.deep, sums.shape[2:]
    ends = apply(matrix, np.array([(0, 0), (width, 0), (0, height), (width, height)], np.float64) - (0.5, 0.5))
    x0, y0 = np.clip(np.floor(ends.min(0)).astype(int) - _MARGIN_PX, 0, pixels.shape[::-1]).tolist()
    x1, y1 = np.clip(np.ceil(ends.max(0)).astype(int) + _MARGIN_PX, 0, pixels.shape[::-1]).tolist()
    if x1 <= x0 or y1 <= y0:
        return
    area = np.s_[y0:y1, x0:x1]
    dark, flat = (each[area] if each.size > 1 else each for each in (source.dark, source.flat))
    grey = pixels[area].astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = (grey * np.float32(source.to_grey) - dark) / (flat * np.float32(source.exposure))
    value[(grey >= source.full) | (flat <= LEAST_FLAT)] = np.nan
    # The taps turn NaN into NaN: the eight neighbours of a saturated pixel are out as well.
    taps = np.array([-SHARPENING_PX2 / 2, 1 + SHARPENING_PX2, -SHARPENING_PX2 / 2], np.float32)
    value = cv2.sepFilter2D(value, -1, taps, taps, borderType=cv2.BORDER_REPLICATE)
    nan = (float("nan"),) * 4
    value = cv2.warpPerspective(value, to_part(matrix, x0, y0), (width, height), flags=_FLAGS, borderValue=nan)
    x, y = np.arange(width), np.arange(height)[:, None]
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in matrix)
    u, v = u / w, v / w
    # Over a block the flat field counts as constant for the noise.
    middle = apply(matrix, np.array([width // 2, height // 2], np.float64))[::-1]
    at = np.clip(np.floor(middle).astype(int), 0, np.array(source.flat.shape) - 1)
    scale = max(float(source.flat[tuple(at)]), LEAST_FLAT) * source.exposure
    # The variance of noise after sharpening and interpolation, divided by that of the frame's pixels.
    factor = np.ones_like(u)
    for fraction in (u - np.floor(u), v - np.floor(v)):
        factor *= MOST_NOISE - LESS_NOISE * fraction * (1 - fraction)
    seen = np.isfinite(value)
    known = np.where(seen, value, 0)
    weight = np.where(seen, scale**2 / (source.read_variance + source.shot_variance * scale * np.maximum(known, 0)), 0)
    for total, part in zip(sums, (weight * known, weight, weight * factor), strict=False):
        total[groups] += part.astype(np.float32)


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

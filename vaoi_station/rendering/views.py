"""The views of a component: the frames that show it, and the matrices from its picture to these frames (equation 22).

The picture (paper, section 3.4) shows the component's bounding box, upright as CAD shows it and never mirrored: CAD x
points right on the top side and left on the bottom side, and CAD "up" points up. A pixel is an area: the edges of the
box are the outer edges of the border pixels. On demand the picture has a margin, is turned to the component's own
orientation, or is right at the top of the body instead of the board (`request.Framing`). One matrix maps its pixels to
CAD coordinates, another one to pixels of the frame. If the lens bends the picture so little that a matrix can represent
it, the matrix to the frame includes the lens. Otherwise the view is `distorted`, and the picture is made in tiles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.homographies import rectangle_homographies, through
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering.request import Framing, Plane, check_number

MOST_PIXELS = 16_000_000
"""Largest number of pixels of a temporary image. A caller who exceeds it must ask for fewer pixels per mm."""
_VERTICAL = 1e-3
"""Tangent of the angle below which a view has no azimuth: it is seen from straight above."""
_STRAIGHT_PX = 0.02
"""Largest deviation from a homography, px, with which a single matrix represents the lens for a whole picture."""
_TILE_PX = 0.003
"""Largest deviation of a tile's homography from the lens, px.

It moves the grey level of a steep edge, 150 levels from pixel to pixel, by less than half a level."""
_MOST_TILES = 24
"""Largest number of tiles along one side of a picture; no usable lens needs as many."""
_CORNERS = (0, 2, 8, 6)
"""Indices of the four corners, in order around the square, among 3×3 points in row order."""
_STAYS = np.eye(3)
"""Displacement of a component that follows C."""
_FITTING = 0.999
"""Share of the largest resolution that is used, because the sides of a picture are rounded to whole pixels."""
_SEARCHED = 1_000_000
"""Number of pairs of a frame and a component that are searched at once, which bounds the memory."""
_GRID = 9
"""Points per side of the grid on which the coverage of a component is computed if the frame shows only a part of it."""
_NEAR = 1.1
"""Factor on the size of a component in a frame, within which a frame may show it: perspective makes it larger."""


class Tile(NamedTuple):
    """A rectangular part of a picture: columns x0 to x1 and rows y0 to y1, ends excluded."""

    x0: int
    y0: int
    x1: int
    y1: int
    matrix: Floats
    """(3, 3) from pixels of the tile, counted from its corner, to raw pixels of the frame."""


@dataclass(eq=False, slots=True)
class View:
    """The view of one component in one frame. It is not changed after it is made."""

    # Not `frozen`: a board has thousands of views, and `object.__setattr__` for every field would double their cost.
    camera: int
    row: int
    width: int
    height: int
    px_per_mm: float
    coverage: float
    """Share of the component's footprint that lies inside the frame."""
    off_center: float
    """Distance from the component's centre to the frame's centre, in half diagonals; 0 is seen from straight above."""
    crop_matrix: Floats
    """(3, 3) matrix from CAD coordinates to pixels of the picture."""
    matrix: Floats
    """(3, 3) matrix from pixels of the picture to raw pixels of the frame; to undistorted pixels if `distorted`."""
    tiles: tuple[Tile, ...]
    """Parts of the picture, each with a matrix to raw pixels, if the view is `distorted`; otherwise empty."""
    outline_px: Floats
    """(4, 2) corners of the component's footprint in raw pixels of the frame, going round."""
    toward: Floats
    """(3,) vector from the component to the camera, mm: along CAD x, along CAD y, up; NaN if it is unknown."""
    lift_px: Floats
    """(2,) shift of the component's centre in the frame per mm of height, px."""
    plane: Plane
    """Plane in which the picture is right."""
    height_mm: float
    """Height of that plane above the board's surface."""

    @property
    def distorted(self) -> bool:
        """Whether the lens distorts this picture too much for a single matrix."""
        return bool(self.tiles)

    @property
    def crop_from_cad(self) -> Projective:
        """Transform from CAD coordinates to pixels of the picture."""
        return Projective(self.crop_matrix, System.CROP, System.CAD)

    @property
    def cad_from_crop(self) -> Projective:
        """Transform from pixels of the picture to CAD coordinates."""
        return self.crop_from_cad.inverse()

    @property
    def image_from_crop(self) -> Projective:
        """Transform from pixels of the picture to pixels of the frame, with the matrix `matrix`."""
        return Projective(self.matrix, System.IMAGE, System.CROP)

    @property
    def frame_px_per_mm(self) -> float:
        """Resolution of the frame at the component's centre, px/mm."""
        return self.image_from_crop.scale_at(((self.width - 1) / 2, (self.height - 1) / 2)) * self.px_per_mm

    @property
    def angle_deg(self) -> float | None:
        """Angle between the line of sight to the component's centre and the vertical; None if it is unknown."""
        x, y, z = self.toward.tolist()
        return None if math.isnan(z) else math.degrees(math.atan2(math.hypot(x, y), z))

    @property
    def azimuth_deg(self) -> float | None:
        """Direction in CAD from which the component is seen, from the x axis towards the y axis, 0 to 360.

        None if it is unknown, or if the component is seen from straight above.
        """
        x, y, z = self.toward.tolist()
        if math.isnan(z) or math.hypot(x, y) < _VERTICAL * z:
            return None
        return math.degrees(math.atan2(y, x)) % 360

    @property
    def picture_azimuth_deg(self) -> float | None:
        """The same direction in the picture: 0 right, 90 up, 180 left, 270 down; None where `azimuth_deg` is None."""
        if self.azimuth_deg is None:
            return None
        x, y = (self.crop_matrix[:2, :2] @ self.toward[:2]).tolist()
        # The picture's y axis points down.
        return math.degrees(math.atan2(-y, x)) % 360

    def covariance_px2(self, of_centre: Floats | None, height_sigma_mm: float = 0.0) -> Floats | None:
        """Return the covariance (2, 2) of the component's place in the frame, px²; None if it is unknown."""
        if of_centre is None:
            return None
        return np.asarray(of_centre + np.outer(self.lift_px, self.lift_px) * height_sigma_mm**2, dtype=np.float64)


def sigma_px(covariance_px2: Floats | None) -> float | None:
    """Return the standard deviation, px, along the direction in which it is largest; None without a covariance."""
    return None if covariance_px2 is None else math.sqrt(max(float(np.linalg.eigvalsh(covariance_px2)[-1]), 0.0))


class Crops(NamedTuple):
    """The pictures of k components, independent of any frame."""

    center: Floats
    """(k, 2) centres of the footprints, CAD."""
    half: Floats
    """(k, 2) half the width and half the height of the footprints before rotation."""
    along: Floats
    """(k, 2, 2) half the width (`[:, :, 0]`) and half the height (`[:, :, 1]`) as vectors in CAD."""
    px_per_mm: Floats
    """(k,) resolution of each picture."""
    size: Floats
    """(k, 2) width and height of each picture in px, whole numbers."""
    crop_from_cad: Floats
    """(k, 3, 3) matrices from CAD coordinates to the pixels of each picture."""
    cad_from_crop: Floats
    """(k, 3, 3) inverse matrices."""
    bare: NDArray[np.bool_]
    """(k,) whether a picture shows the footprint and nothing else."""


def lay_out(components: Sequence[Component], board_type: BoardType, framing: Framing, px_per_mm: float) -> Crops:
    """Compute the pictures of components. `px_per_mm` is the resolution if `framing` states none.

    It is lower for a picture that would be too large: one large component must not prevent the list of all. A
    resolution or a margin that the caller has chosen is not changed.

    Raises:
        InputError: a picture would have more than `MOST_PIXELS`.
    """
    rows = [(*c.center, c.width / 2, c.height / 2, c.rotation) for c in components]
    values = np.array(rows, dtype=np.float64).reshape(-1, 5)
    center, half, rotation = values[:, :2], values[:, 2:4], values[:, 4]
    mm, turned = board_type.mm_per_unit, framing.align == "part"
    # Pictures show the board as the camera sees it, never mirrored (docs/conventions.md). On the bottom side, CAD x
    # runs to the left. Rotations count counter-clockwise as seen on the top of the board, wherever the y axis points.
    way = np.array([1.0 if board_type.side == "top" else -1.0, 1.0 if board_type.y_axis == "down" else -1.0])
    angle = np.radians(rotation) * -way[1]
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(-1, 2, 2)
    along = turn * half[:, None]
    box = np.abs(along).sum(2)
    if framing.px_per_mm:
        resolution = np.full(len(rows), float(framing.px_per_mm))
    else:
        resolution = np.minimum(px_per_mm, _FITTING * np.sqrt(MOST_PIXELS / (4 * box.prod(1) * mm * mm)))
    shown = half if turned else box
    reach = shown + framing.margin_mm / mm
    # The scale uses the rounded size, so that the box fills the picture exactly: sides change by less than a pixel.
    size = np.maximum(np.rint(2 * reach * resolution[:, None] * mm), 1)
    for k in np.flatnonzero(size.prod(1) > MOST_PIXELS).tolist():
        sides_mm = (2 * shown[k] * mm).tolist()
        raise _too_large(components[k], sides_mm, float(resolution[k]), framing, size[k].tolist())
    scale = way * size / (2 * reach)
    # The columns are the directions in CAD that run along the axes of the picture.
    axes = turn if turned else np.broadcast_to(np.eye(2), turn.shape)
    there, back = np.zeros((2, len(rows), 3, 3))
    there[:, :2, :2] = scale[:, :, None] * axes.swapaxes(1, 2)
    there[:, :2, 2] = (size - 1) / 2 - (there[:, :2, :2] @ center[:, :, None])[..., 0]
    back[:, :2, :2] = axes / scale[:, None]
    back[:, :2, 2] = center - (back[:, :2, :2] @ (size - 1)[:, :, None] / 2)[..., 0]
    there[:, 2, 2] = back[:, 2, 2] = 1
    # At whole quarter turns the bounding box is the footprint.
    straight = np.abs(along).min((1, 2)) <= 1e-9 * half.max(1)
    bare = (framing.margin_mm == 0) & (turned | straight)
    return Crops(center, half, along, resolution, size, there, back, bare)


def _too_large(
    component: Component, sides_mm: list[float], px_per_mm: float, framing: Framing, size: list[float]
) -> InputError:
    """Return the refusal of a picture that is too large: its margin or its resolution."""
    (a, b), most = sides_mm, MOST_PIXELS / px_per_mm**2
    what = f"small enough for {MOST_PIXELS / 1e6:.0f} megapixels (this would be {size[0]:.0f}×{size[1]:.0f})"
    if not framing.margin_mm or a * b > most:
        area = (a + 2 * framing.margin_mm) * (b + 2 * framing.margin_mm)
        limit = f"at most {_floored(0.999 * math.sqrt(MOST_PIXELS / area))}, {what}"
        return InputError.field(component.address, "px_per_mm", px_per_mm, limit)
    # The margin m at which (a + 2 m)(b + 2 m) is as large as a picture may be.
    margin = (math.sqrt((a - b) ** 2 + 4 * most) - (a + b)) / 4
    limit = f"at most {_floored(margin)} at {px_per_mm:g} px/mm, {what}"
    return InputError.field(component.address, "margin_mm", framing.margin_mm, limit)


def _floored(limit: float) -> str:
    """Return a limit with two decimals that is not above it."""
    return f"{math.floor(100 * limit) / 100:g}"


@dataclass(frozen=True, eq=False)
class ViewTable(Mapping[str, tuple[View, ...]]):
    """The v views of n components by address, ordered by component, those of one component best first; as in `View`.

    They are arrays, of which objects are made when the first one is read: to make an object of each view takes half as
    long as to compute them all, and is not needed where views are only counted.
    """

    components: Sequence[Component]
    crops: Crops
    above_mm: Floats
    """(n,) height of the plane of each picture above the board's surface."""
    on_top: NDArray[np.bool_]
    """(n,) whether this plane is the top of the body."""
    component: NDArray[np.int_]
    """(v,) number of the component."""
    key: NDArray[np.int_]
    """(v, 2) camera and row."""
    coverage: Floats
    off_center: Floats
    matrix: Floats
    """(v, 3, 3)."""
    outline_px: Floats
    """(v, 4, 2)."""
    tiles: Mapping[int, tuple[Tile, ...]]
    """By number of the view, for those that are distorted."""
    sights: Callable[[], tuple[Floats, Floats]]
    """Function that computes `toward` (v, 3) and `lift_px` (v, 2) of all views."""

    def __getitem__(self, address: str) -> tuple[View, ...]:
        """Return the views of a component; the first call makes those of all."""
        return self._views[address]

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)

    @cached_property
    def addresses(self) -> list[str]:
        """The addresses of the components."""
        return [component.address for component in self.components]

    def views_of(self, number: int) -> tuple[View, ...]:
        """Make the views of the component with a number, and keep none: they take several times the arrays' memory."""
        first, end = np.searchsorted(self.component, (number, number + 1)).tolist()
        return tuple(view for _, view in self._made(first, end))

    def counts_in(self, frames: Collection[tuple[int, int]]) -> dict[str, int]:
        """Return for each component the number of views in some frames."""
        inside = [key in frames for key in map(tuple, self.key.tolist())]
        count = np.bincount(self.component[inside], minlength=len(self.addresses))
        return {address: n for address, n in zip(self.addresses, count.tolist(), strict=True) if n}

    @cached_property
    def _views(self) -> dict[str, tuple[View, ...]]:
        found: list[list[View]] = [[] for _ in self.addresses]
        for k, view in self._made(0, len(self.component)):
            found[k].append(view)
        return {address: tuple(views) for address, views in zip(self.addresses, found, strict=True)}

    @cached_property
    def _sights(self) -> tuple[Floats, Floats]:
        return self.sights()

    @cached_property
    def _pictures(self) -> list[tuple[int, int, float, Floats, Plane, float]]:
        """Size, resolution, matrix from CAD, plane and height of the picture of each component."""
        crops = self.crops
        size, planes = crops.size.astype(int).T.tolist(), np.where(self.on_top, "top", "board").tolist()
        return list(
            zip(*size, crops.px_per_mm.tolist(), crops.crop_from_cad, planes, self.above_mm.tolist(), strict=True)
        )

    def _made(self, first: int, end: int) -> Iterator[tuple[int, View]]:
        """Make the views from `first` to `end`, which is excluded; yield each with the number of its component."""
        part = slice(first, end)
        # Python's own numbers, and rows of arrays, made at once: one by one they take longer than the views themselves.
        numbers = (v[part].tolist() for v in (self.component, self.key, self.coverage, self.off_center))
        arrays = (v[part] for v in (self.matrix, self.outline_px, *self._sights))
        for n, (k, (i, j), share, distance, matrix, corners, sight, shift) in enumerate(
            zip(*numbers, *arrays, strict=True), first
        ):
            width, height, resolution, crop_matrix, plane, above_mm = self._pictures[k]
            yield k, View(
                i, j, width, height, resolution, share, distance, crop_matrix, matrix,
                self.tiles.get(n, ()), corners, sight, shift, plane, above_mm,
            )  # fmt: skip


class _Pairs(NamedTuple):
    """p pairs of a component and a frame that shows it, ordered by component, those of one component best first."""

    component: NDArray[np.int_]
    """(p,) number of the component of each pair."""
    frame: NDArray[np.int_]
    """(p,) number of the frame of each pair."""
    image_from_cad: Floats
    """(p, 3, 3) from CAD to undistorted pixels of the frame, in the plane of the picture."""
    image_from_crop: Floats
    """(p, 3, 3) from pixels of the picture to undistorted pixels of the frame."""
    coverage: Floats
    """(p,) share of the footprint inside the frame."""
    off_center: Floats
    """(p,) distance of the footprint's centre from that of the frame, in half diagonals."""
    outline_px: Floats
    """(p, 4, 2) corners of the footprint in raw pixels, going round."""
    picture_px: Floats
    """(p, 9, 2) raw pixels of 3×3 points over the picture, row by row."""


class ViewCalculator:
    """Calculator of the views of one board's components. Values that all components share are computed once."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices and cameras of one run.

        Raises:
            StateError: the run has no CAD mapping.
        """
        index = self._index = FrameIndex.of_result(stitch, cameras)
        self._board_type = board_type
        i, row = index.key.T
        # A height decreases the third column of CAD → image (`geometry.Camera`).
        eye = np.array([(*c.viewpoint[:2], 1.0) for c in index.cameras])
        inverse = np.array([c.viewpoint[2] for c in index.cameras])
        lean = (index.arrays.image_from_row @ eye[:, :, None])[:, :, 0] * inverse[:, None]
        self._image_from_cad = index.arrays.image_from_row[i] @ index.row_from_cad[row]
        """(f, 3, 3) to undistorted pixels, in the calibrated plane."""
        self._lean = lean[i]
        """(f, 3) decrease of the third column of that matrix per mm of height."""
        self._bend = np.array([_bend(c) for c in index.cameras])[i]
        """(f,) largest shift that the lens causes, px."""
        self._scale = np.array([_NEAR * c.px_per_mm * board_type.mm_per_unit for c in index.cameras])[i]
        """(f,) px per CAD unit, at most."""
        self._own = stitch.displacements(c.address for c in board_type.components)
        """(3, 3) by address, for components with a C of their own: CAD coordinates → those of the same place by C."""

    @property
    def knows_heights(self) -> bool:
        """Whether the working distance of every camera is known, so that heights and directions can be computed."""
        return not np.isnan(self._index.eye_mm[:, 2]).any()

    def compute(
        self,
        component: Component,
        *,
        px_per_mm: float | None = None,
        min_coverage: float = 0.5,
        framing: Framing | None = None,
        height_mm: float | None = None,
    ) -> tuple[View, ...]:
        """Compute the views of one component: highest coverage first, then smallest distance from the frame's centre.

        The arguments are those of `compute_all`; `height_mm` is that of its body, if it is known.
        """
        heights = {} if height_mm is None else {component.address: height_mm}
        views = self.compute_all(
            [component], px_per_mm=px_per_mm, min_coverage=min_coverage, framing=framing, heights_mm=heights
        )
        return views[component.address]

    def compute_all(
        self,
        components: Sequence[Component],
        *,
        px_per_mm: float | None = None,
        min_coverage: float = 0.5,
        framing: Framing | None = None,
        heights_mm: Mapping[str, float] | None = None,
    ) -> ViewTable:
        """Compute the views of many components at once; the keys are the components' addresses.

        Args:
            components: components of the board type.
            px_per_mm: resolution of the pictures; by default that of `framing`, or the mean one of the cameras.
            min_coverage: least share of the component inside a frame; frames that show less are left out.
            framing: margin, orientation and plane of the pictures.
            heights_mm: known heights of bodies above the board by address, for pictures in the plane of their tops;
                those of other components lie in the board's plane.

        Raises:
            InputError: a picture would be too large, or a value is outside its limits.
        """
        framing = framing or Framing()
        framing = (framing if px_per_mm is None else replace(framing, px_per_mm=px_per_mm)).check()
        check_number("min_coverage", min_coverage)
        crops = lay_out(components, self._board_type, framing, self._index.px_per_mm)
        tops = heights_mm if framing.plane == "top" and heights_mm else {}
        above_mm, on_top = np.zeros(len(components)), np.zeros(len(components), np.bool_)
        if tops:
            above_mm[:] = [tops.get(c.address, 0.0) for c in components]
            on_top[:] = [c.address in tops for c in components]
        surface = self._index.surface
        height_mm = above_mm if surface is None else above_mm + surface.height_mm(crops.center)
        pairs = self._pairs(components, crops, height_mm, min_coverage)
        matrices, bend_px = self._through_lenses(crops, pairs)
        return ViewTable(
            components, crops, above_mm, on_top, pairs.component, self._index.key[pairs.frame], pairs.coverage,
            pairs.off_center, matrices, pairs.outline_px, self._tiles(crops, pairs, bend_px),
            lambda: self._sights(crops, pairs, height_mm),
        )  # fmt: skip

    def _pairs(self, components: Sequence[Component], crops: Crops, height_mm: Floats, least: float) -> _Pairs:
        """Find the frames that show at least the share `least` of components, and what they show of them."""
        own = [self._own.get(c.address, _STAYS) for c in components] if self._own else [_STAYS]
        moves = np.broadcast_to(np.array(own, dtype=np.float64).reshape(-1, 3, 3), (len(components), 3, 3))
        centers = np.column_stack([crops.center, np.ones(len(components))])
        # A frame shows at most half of a footprint whose centre it does not show: both are symmetric or convex.
        reach = np.hypot(*crops.half.T) if least < 0.5 else np.zeros(len(components))
        moved, last = (moves @ centers[:, :, None])[..., 0], self._index.size_px - 1
        step = max(1, _SEARCHED // max(len(components), 1))
        found: list[tuple[NDArray[np.int_], NDArray[np.int_]]] = []
        for b in range(0, len(last), step):
            some = slice(b, b + step)
            # (frames, components, 3). Most frames show only few components.
            at = moved @ self._image_from_cad[some].swapaxes(1, 2) - height_mm[:, None] * self._lean[some, None]
            margin = (self._bend[some, None] + 1 + self._scale[some, None] * reach)[..., None]
            place = at[..., :2] / at[..., 2:]
            near = np.nonzero(((place >= -margin) & (place <= last[some, None] + margin)).all(-1))
            found.append((near[0] + b, near[1]))
        f, k = (np.concatenate([pair[n] for pair in found]) if found else np.zeros(0, np.int_) for n in range(2))
        image_from_cad = self._image_from_cad[f]
        image_from_cad[:, :, 2] -= height_mm[k, None] * self._lean[f]
        image_from_cad = image_from_cad @ moves[k]
        image_from_crop = image_from_cad @ crops.cad_from_crop[k]
        picture = self._distorted(f, through(image_from_crop, _grid(crops.size[k], 3)))
        # A footprint is shown if the centres of its outermost pixels are: a pixel of the picture has one place.
        half_px = crops.half * (crops.px_per_mm * self._board_type.mm_per_unit)[:, None]
        inner = crops.along * np.maximum(1 - 0.5 / half_px, 0)[:, None]

        def footprint(some: NDArray[np.int_], n: int) -> Floats:
            """Return the raw pixels (q, n², 2) of a grid over the footprints of some of the pairs."""
            points = crops.center[k[some], None] + _square(n) @ inner[k[some]].swapaxes(1, 2)
            return self._distorted(f[some], through(image_from_cad[some], points))

        points, beside = picture.copy(), np.flatnonzero(~crops.bare[k])
        points[beside] = footprint(beside, 3)
        coverage, partly = np.ones(len(k)), np.flatnonzero(~_inside(points, last[f]).all(1))
        coverage[partly] = _inside(footprint(partly, _GRID), last[f[partly]]).mean(1)
        middle = last[f] / 2
        off_center = np.hypot(*(points[:, 4] - middle).T) / np.hypot(*middle.T)
        camera, row = self._index.key[f].T
        # Rounded, so that the order does not depend on the last digits of nearly equal values.
        order = np.lexsort((camera, row, np.rint(off_center * 1e6), -coverage, k))
        best = order[coverage[order] >= max(least, 1e-9)]
        return _Pairs(
            k[best], f[best], image_from_cad[best], image_from_crop[best], coverage[best], off_center[best],
            points[best][:, _CORNERS], picture[best],
        )  # fmt: skip

    def _through_lenses(self, crops: Crops, pairs: _Pairs) -> tuple[Floats, Floats]:
        """Replace matrices to undistorted pixels by matrices to raw ones where a matrix can represent the lens.

        Return all matrices (p, 3, 3), and the deviation of the lens from a homography (p,), px: 0 for a picture that is
        not distorted.
        """
        matrices, bend_px = pairs.image_from_crop, np.zeros(len(pairs.component))
        if not self._index.distorts.any():
            return matrices, bend_px
        points, picture = _grid(crops.size[pairs.component], 3), pairs.picture_px
        straight = rectangle_homographies(points[:, _CORNERS], picture[:, _CORNERS])
        apart_px = np.abs(through(straight, points) - picture).max((1, 2))
        # NaN, of a picture a pixel wide, counts as bent.
        lensed = self._index.distorts[self._index.key[pairs.frame, 0]]
        bent = lensed & ~(apart_px <= _STRAIGHT_PX)
        bend_px[bent] = np.nan_to_num(apart_px[bent], nan=np.inf)
        return np.where((lensed & ~bent)[:, None, None], straight, matrices), bend_px

    def _tiles(self, crops: Crops, pairs: _Pairs, bend_px: Floats) -> dict[int, tuple[Tile, ...]]:
        """Cut the distorted pictures among those of the pairs into tiles; the keys are the numbers of the pairs."""
        bent = np.flatnonzero(bend_px)
        if not len(bent):
            return {}
        frame, size = pairs.frame[bent], crops.size[pairs.component[bent]]
        matrices = pairs.image_from_crop[bent]
        cut = cut_tiles(matrices, size, bend_px[bent], lambda k, points: self._distorted(frame[k], points))
        return dict(zip(bent.tolist(), cut, strict=True))

    def _sights(self, crops: Crops, pairs: _Pairs, height_mm: Floats) -> tuple[Floats, Floats]:
        """Compute the vector from each component to the camera (p, 3), CAD axes, mm, and the shift per mm of height."""
        k, frame = pairs.component, pairs.frame
        row_from_cad, eye = self._index.row_from_cad[self._index.key[frame, 1]], self._index.eye_mm[frame]
        center = np.column_stack([crops.center, np.ones(len(crops.center))])[k, :, None]
        turn = row_from_cad[:, :2, :2]
        sight = eye[:, :2] - (row_from_cad[:, :2] @ center)[..., 0]
        # Row from CAD is a similarity: its transpose, divided by its scale, turns vectors back and keeps their length.
        scale = np.sqrt(np.abs(turn[:, 0, 0] * turn[:, 1, 1] - turn[:, 0, 1] * turn[:, 1, 0]))
        flat = (turn.swapaxes(1, 2) @ sight[:, :, None])[..., 0] / scale[:, None]
        toward = np.column_stack([flat, eye[:, 2] - height_mm[k]])
        at = (pairs.image_from_cad @ center)[..., 0]
        lean = self._lean[frame]
        lift = (at[:, :2] / at[:, 2:] * lean[:, 2:] - lean[:, :2]) / at[:, 2:]
        return toward, lift

    def _distorted(self, frame: NDArray[np.int_], points: Floats) -> Floats:
        """Return the raw pixels (p, n, 2) of undistorted pixels of p frames. `points` is overwritten."""
        of = self._index.key[frame, 0]
        # Few cameras see one component.
        for i in set(of[self._index.distorts[of]].tolist()):
            mine = np.flatnonzero(of == i)
            points[mine] = self._index.cameras[i].lens.distort(np.ascontiguousarray(points[mine]))
        return points


def cut_tiles(
    matrices: Floats, size: Floats, bend_px: Floats, distort: Callable[[NDArray[np.int_], Floats], Floats]
) -> list[tuple[Tile, ...]]:
    """Cut each of k pictures into tiles, whose corners are mapped through the lens exactly; return the tiles of each.

    Args:
        matrices: (k, 3, 3) from pixels of the picture to undistorted pixels of the frame.
        size: (k, 2) width and height of the pictures.
        bend_px: (k,) largest deviation of the lens from a homography over the whole picture.
        distort: function that takes the number of a picture for each of t tiles, and undistorted pixels (t, 4, 2) of
            their corners; it returns raw pixels.
    """
    # The deviation falls with the square of the number of tiles along a side.
    parts = np.ceil(np.sqrt(np.minimum(bend_px / _TILE_PX, _MOST_TILES**2))).astype(int)
    boxes: list[tuple[int, int, int, int]] = []
    of = []
    for (width, height), n in zip(size.astype(int).tolist(), parts.tolist(), strict=True):
        # About square tiles: along its shorter side a picture needs fewer.
        longer = max(width, height)
        own = rectangles(width, height, math.ceil(n * width / longer), math.ceil(n * height / longer))
        boxes += own
        of.append(len(own))
    # All tiles of all pictures at once: most pictures have few tiles.
    x0, y0, x1, y1 = np.array(boxes, dtype=np.float64).T - 0.5
    corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], -1).reshape(-1, 4, 2)
    picture = np.repeat(np.arange(len(of)), of)
    raw = distort(picture, through(matrices[picture], corners))
    found = rectangle_homographies(corners - corners[:, :1] - 0.5, raw)
    tiles = list(map(Tile, *zip(*boxes, strict=True), found))
    ends = np.cumsum(of).tolist()
    return [tuple(tiles[begin:end]) for begin, end in zip([0, *ends], ends, strict=False)]


def rectangles(width: int, height: int, columns: int, rows: int) -> list[tuple[int, int, int, int]]:
    """Cut a picture into about equal parts; return x0, y0, x1, y1 of each, ends excluded."""
    # OpenCV computes 16 pixels of a row at a time, and the rest of a row one by one.
    x, y = _cuts(width, columns, 16 if width >= 32 * columns else 1), _cuts(height, rows, 1)
    return [(a, b, c, d) for b, d in pairwise(y) for a, c in pairwise(x)]


def _cuts(length: int, parts: int, step: int) -> list[int]:
    """Return the positions, both ends included, at which a side of this length is cut into parts.

    Positions between the ends are multiples of `step`.
    """
    parts = max(min(parts, length // 2), 1)
    return [0, *(round(k * length / parts / step) * step for k in range(1, parts)), length]


def _inside(points: Floats, last: Floats) -> NDArray[np.bool_]:
    """Return which raw pixels (p, n, 2) lie in their frames, whose last pixels are (p, 2) (equation 22)."""
    return np.asarray(((points >= 0) & (points <= last[:, None])).all(-1))


def _bend(camera: Camera) -> float:
    """Compute the largest shift, in px, that the lens causes on a 3×3 grid of points over the frame."""
    if camera.lens.ideal:
        return 0.0
    corners = _grid(np.array([[camera.width_px, camera.height_px]]), 3)[0]
    return float(np.abs(camera.lens.undistort(corners) - corners).max())


def _grid(size: Floats, n: int) -> Floats:
    """Return a grid of n×n points (k, n², 2), row by row, over the pixels of k pictures of sizes (k, 2)."""
    # In memory in the order that `through` computes.
    return np.asarray((((_square(n) + 1) / 2).T[:, :, None] * (size.T[:, None] - 1)).T)


@lru_cache(maxsize=4)
def _square(n: int) -> Floats:
    """Return a grid of n×n points (n², 2), row by row, over the square from −1 to 1."""
    t = np.linspace(-1, 1, n)
    return np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)

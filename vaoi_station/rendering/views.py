"""The views of a component: the frames that show it, and the matrices from its picture to these frames (equation 22).

The picture (paper, section 3.4) shows the component's bounding box, upright as CAD shows it and never mirrored: CAD x
points right on the top side and left on the bottom side, and CAD "up" points up. On demand it has a margin, is turned
to the component's own orientation, or is right at the top of the body instead of the board (`framing.Framing`). One
matrix maps the pixels of the picture to CAD coordinates, another one to pixels of the frame. If the lens bends the
picture so little that a matrix can represent it, the matrix to the frame includes the lens. Otherwise the view is
`distorted`, and the picture is made in tiles, each with a matrix. If the board's surface is known, the footprint lies
at the height of the surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import StateError
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering.crops import Crops, Footprints, compute_crops
from vaoi_station.rendering.framing import Framing, check_number
from vaoi_station.rendering.tiles import cut_tiles, rectangle_homographies, through
from vaoi_station.rendering.view import Tile, View
from vaoi_station.rendering.view_table import Columns, Sights, ViewTable

GRID = 9
"""Points per side of the grid on which the coverage of a component is computed if the frame shows only a part of it."""
_STRAIGHT_PX = 0.02
"""Largest deviation from a homography, px, with which a single matrix represents the lens for a whole picture."""
_CORNERS = (0, 2, 8, 6)
"""Indices of the four corners, in order around the square, among 3×3 points in row order."""
_NEAR = 1.1
"""Factor on the size of a component in a frame, within which a frame may show it: perspective makes it larger."""


class _Pairs(NamedTuple):
    """p pairs of a component and a frame that may show it, ordered by component."""

    component: NDArray[np.int_]
    """(p,) number of the component of each pair."""
    frame: NDArray[np.int_]
    """(p,) number of the frame of each pair."""
    image_from_cad: Floats
    """(p, 3, 3) from CAD to undistorted pixels of the frame, in the plane of the picture."""


class ViewCalculator:
    """Calculator of the views of one board's components. Values that all components share are computed once."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices and cameras of one run.

        Raises:
            StateError: the run has no CAD mapping.
        """
        tester_from_cad = stitch.tester_from_cad
        if tester_from_cad is None:
            raise StateError(
                "this run has no CAD mapping, so components cannot be cut out.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        cameras = stitch.cameras(cameras)
        self._board_type, self._surface, self._cameras = board_type, stitch.surface, cameras
        self._resolution = float(np.mean([c.px_per_mm for c in cameras]))
        keys = [(i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None]
        self._key = np.array(keys, dtype=np.int_).reshape(-1, 2)
        """(f, 2) camera and row of each of f frames."""
        i = self._key[:, 0]
        motion = np.array(stitch.row_motion, dtype=np.float64).reshape(-1, 3, 3)
        self._row_from_cad = (motion @ tester_from_cad.matrix)[self._key[:, 1]]
        image_from_row = np.array([c.image_from_row.matrix for c in cameras])
        self._image_from_cad = image_from_row[i] @ self._row_from_cad
        feet = np.array([(*c.foot_mm, 1.0) for c in cameras])
        distance_mm = np.array([c.working_distance_mm or np.inf for c in cameras])
        self._lean = ((image_from_row @ feet[:, :, None])[:, :, 0] / distance_mm[:, None])[i]
        """(f, 3) for f frames: decrease of the third column of CAD → image per mm of height (`geometry.Camera`)."""
        self._eye = np.column_stack([feet[:, :2], np.where(np.isinf(distance_mm), np.nan, distance_mm)])[i]
        """(f, 3) centre of the camera in row coordinates; its height is NaN if it is unknown."""
        self._size = np.array([(c.width_px, c.height_px) for c in cameras], dtype=np.float64)[i]
        self._scale = _NEAR * np.array([c.px_per_mm for c in cameras])[i] * board_type.mm_per_unit
        self._lensed = np.array([not c.lens.ideal for c in cameras])
        self._bend = np.array([_bend(c) for c in cameras])[i]
        self._own = stitch.displacements(c.address for c in board_type.components)
        """(3, 3) by address, for components with a C of their own: CAD coordinates → those of the same place by C."""

    @property
    def knows_heights(self) -> bool:
        """Whether the working distance of every camera is known, so that heights and directions can be computed."""
        return not np.isnan(self._eye[:, 2]).any()

    def compute(
        self,
        component: Component,
        *,
        px_per_mm: float | None = None,
        min_coverage: float = 0.5,
        framing: Framing | None = None,
        height_mm: float | None = None,
    ) -> tuple[View, ...]:
        """Compute the views of one component; see `compute_views`. `height_mm` is that of its body, if it is known."""
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

        `px_per_mm` replaces the resolution of `framing`. `heights_mm` are the known heights of bodies above the board
        by address; pictures of other components lie in the board's plane.
        """
        framing = framing or Framing()
        framing = (framing if px_per_mm is None else replace(framing, px_per_mm=px_per_mm)).check()
        check_number("min_coverage", min_coverage, 0.0, 1.0)
        crops = self._crops(components, framing)
        tops = heights_mm if framing.plane == "top" and heights_mm else {}
        addresses = [c.address for c in components]
        above_mm = np.array([tops.get(address, 0.0) for address in addresses])
        on_top = np.array([address in tops for address in addresses])
        surface = self._surface
        height_mm = above_mm if surface is None else above_mm + surface.height_mm(crops.footprints.center)
        own = np.array([self._own.get(address, np.eye(3)) for address in addresses]) if self._own else None
        pairs = self._pairs(crops, height_mm, min_coverage, own)
        matrices = pairs.image_from_cad @ crops.cad_from_crop[pairs.component]
        picture = through(matrices, _grid(crops.size[pairs.component], 3))
        picture = self._distorted(pairs.frame, picture)
        coverage, outline, middle = self._shown(crops, pairs, picture)
        matrices, bend_px = self._through_lenses(crops, pairs, matrices, picture)
        lens_center = (self._size[pairs.frame] - 1) / 2
        off = np.hypot(*(middle - lens_center).T) / np.hypot(*lens_center.T)
        # Coverages are rounded, so that the order does not depend on the last digits of nearly equal values.
        key = self._key[pairs.frame]
        order = np.lexsort((key[:, 0], key[:, 1], off.round(6), -coverage.round(3), pairs.component))
        order = order[coverage[order] >= max(min_coverage, 1e-9)]
        pairs = _Pairs(pairs.component[order], pairs.frame[order], pairs.image_from_cad[order])
        matrices, bend_px = matrices[order], bend_px[order]
        tiles = self._tiles(crops, pairs, matrices, bend_px)
        columns = Columns(pairs.component, key[order], coverage[order], off[order], matrices, outline[order], tiles)
        return ViewTable(addresses, crops, above_mm, on_top, columns, lambda: self._sights(crops, pairs, height_mm))

    def _crops(self, components: Sequence[Component], framing: Framing) -> Crops:
        # A picture that would be too large at the cameras' resolution gets fewer pixels: one large component must not
        # prevent the list of all components. A resolution or a margin that the caller has chosen is not changed.
        shapes = Footprints.of(components, self._board_type)
        chosen = framing.px_per_mm
        return compute_crops(shapes, shapes.fitting(self._resolution) if chosen is None else chosen, framing)

    def _pairs(self, crops: Crops, height_mm: Floats, min_coverage: float, own: Floats | None) -> _Pairs:
        """Find the pairs of a component and a frame that may show it. Most frames show only few components.

        `own` (n, 3, 3) are the displacements of components with a C of their own; None if no component has one.
        """
        # A frame shows at most half of a footprint whose centre it does not show: both are symmetric or convex.
        margin = self._bend[:, None] + 1
        if min_coverage < 0.5:
            margin = margin + self._scale[:, None] * np.linalg.norm(crops.footprints.half, axis=-1)
        center = _homogeneous(crops.footprints.center)
        center = center if own is None else (own @ center[:, :, None])[:, :, 0]
        # One product in place of one for each frame, which takes longer.
        straight = (self._image_from_cad.reshape(-1, 3) @ center.T).reshape(len(self._key), 3, -1)
        seen = straight - self._lean[:, :, None] * height_mm
        at = seen[:, :2] / seen[:, 2:]
        (x, y), (right, bottom) = at.swapaxes(0, 1), self._size.T[:, :, None] - 1 + margin
        touching = (x >= -margin) & (y >= -margin) & (x <= right) & (y <= bottom)
        component, frame = np.nonzero(touching.T)
        image_from_cad = self._image_from_cad[frame]
        image_from_cad[:, :, 2] -= height_mm[component, None] * self._lean[frame]
        return _Pairs(component, frame, image_from_cad if own is None else image_from_cad @ own[component])

    def _shown(self, crops: Crops, pairs: _Pairs, picture: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute coverage (p,), corners of the footprint (p, 4, 2), and its centre (p, 2), both in raw pixels.

        `picture` (p, 9, 2) are the raw pixels of 3×3 points over each picture.
        """
        center, half = crops.footprints.center[:, None], crops.footprints.half
        # A footprint is shown if the centres of its outermost pixels are: a pixel of the picture has one place.
        half_px = half * (crops.px_per_mm * self._board_type.mm_per_unit)[:, None]
        inner = crops.footprints.along * np.maximum(1 - 0.5 / half_px, 0)[:, None]
        raw = picture
        # Most pictures show the footprint and nothing else, so its points are those of the picture.
        if len(other := np.flatnonzero(~crops.bare[pairs.component])):
            k, raw = pairs.component[other], picture.copy()
            points = through(pairs.image_from_cad[other], center[k] + _square(3) @ inner[k].swapaxes(1, 2))
            raw[other] = self._distorted(pairs.frame[other], points)
        coverage = np.array(self._inside(pairs.frame, raw).all(1), dtype=np.float64)
        # Most footprints lie completely inside the frame. Only the others are sampled finely.
        part = np.flatnonzero(coverage < 1)
        k, frame = pairs.component[part], pairs.frame[part]
        fine = through(pairs.image_from_cad[part], center[k] + _square(GRID) @ inner[k].swapaxes(1, 2))
        coverage[part] = self._inside(frame, self._distorted(frame, fine)).mean(1)
        return coverage, raw[:, _CORNERS], raw[:, 4]

    def _through_lenses(self, crops: Crops, pairs: _Pairs, matrices: Floats, picture: Floats) -> tuple[Floats, Floats]:
        """Replace matrices to undistorted pixels by matrices to raw ones where a matrix can represent the lens.

        Return all matrices (p, 3, 3), and the deviation of the lens from a homography (p,), px: 0 for a picture that is
        not distorted. `picture` is that of `_shown`.
        """
        bend_px = np.zeros(len(matrices))
        if not self._lensed.any():
            return matrices, bend_px
        points = _grid(crops.size[pairs.component], 3)
        straight = rectangle_homographies(points[:, _CORNERS], picture[:, _CORNERS])
        apart_px = np.abs(through(straight, points) - picture).max((1, 2))
        # NaN, of a picture a pixel wide, counts as bent.
        lensed = self._lensed[self._key[pairs.frame, 0]]
        bent = lensed & ~(apart_px <= _STRAIGHT_PX)
        bend_px[bent] = np.nan_to_num(apart_px[bent], nan=np.inf)
        return np.where((lensed & ~bent)[:, None, None], straight, matrices), bend_px

    def _tiles(self, crops: Crops, pairs: _Pairs, matrices: Floats, bend_px: Floats) -> dict[int, tuple[Tile, ...]]:
        """Cut the distorted pictures among those of the pairs into tiles; the keys are the numbers of the pairs."""
        bent = np.flatnonzero(bend_px)
        if not len(bent):
            return {}
        frame, size = pairs.frame[bent], crops.size[pairs.component[bent]]
        cut = cut_tiles(matrices[bent], size, bend_px[bent], lambda k, points: self._distorted(frame[k], points))
        return dict(zip(bent.tolist(), cut, strict=True))

    def _sights(self, crops: Crops, pairs: _Pairs, height_mm: Floats) -> Sights:
        """Compute the vector from each component to the camera (p, 3), CAD axes, mm, and the shift per mm of height."""
        k, frame = pairs.component, pairs.frame
        center = _homogeneous(crops.footprints.center)[k, :, None]
        turn = self._row_from_cad[frame, :2, :2]
        sight = self._eye[frame, :2] - (self._row_from_cad[frame, :2] @ center)[..., 0]
        # Row from CAD is a similarity: its transpose, divided by its scale, turns vectors back and keeps their length.
        scale = np.sqrt(np.abs(turn[:, 0, 0] * turn[:, 1, 1] - turn[:, 0, 1] * turn[:, 1, 0]))
        flat = (turn.swapaxes(1, 2) @ sight[:, :, None])[..., 0] / scale[:, None]
        toward = np.column_stack([flat, self._eye[frame, 2] - height_mm[k]])
        at = (pairs.image_from_cad @ center)[..., 0]
        lean = self._lean[frame]
        lift = (at[:, :2] / at[:, 2:] * lean[:, 2:] - lean[:, :2]) / at[:, 2:]
        return Sights(toward, lift)

    def _distorted(self, frame: NDArray[np.int_], points: Floats) -> Floats:
        """Return the raw pixels (p, n, 2) of undistorted pixels of p frames. `points` is overwritten."""
        of = self._key[frame, 0]
        # Few cameras see one component.
        for i in set(of[self._lensed[of]].tolist()):
            mine = np.flatnonzero(of == i)
            points[mine] = self._cameras[i].lens.distort(points[mine])
        return points

    def _inside(self, frame: NDArray[np.int_], raw: Floats) -> NDArray[np.bool_]:
        """Return whether raw pixels (p, n, 2) of p frames lie inside (p, n); equation 22."""
        x, y = raw[..., 0], raw[..., 1]
        right, bottom = self._size[frame].T[:, :, None] - 1
        return np.asarray((x >= 0) & (y >= 0) & (x <= right) & (y <= bottom))


def compute_views(
    component: Component,
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    *,
    px_per_mm: float | None = None,
    min_coverage: float = 0.5,
    framing: Framing | None = None,
) -> tuple[View, ...]:
    """Compute the views of a component: highest coverage first, then smallest distance from the frame's centre.

    Args:
        component: a component of the board type.
        board_type: board type of the run; its unit, axes and side are used.
        stitch: result of the run; its matrices and surface are used.
        cameras: cameras of the calibration with which the run was stitched.
        px_per_mm: resolution of the pictures; by default that of `framing`, or the mean resolution of the cameras.
        min_coverage: least share of the component inside a frame; frames that show less are left out.
        framing: margin, orientation and plane of the pictures.

    Raises:
        StateError: the run has no CAD mapping.
        InputError: the picture would be too large, or a value is outside its limits.
    """
    return ViewCalculator(board_type, stitch, cameras).compute(
        component, px_per_mm=px_per_mm, min_coverage=min_coverage, framing=framing
    )


def _bend(camera: Camera) -> float:
    """Compute the largest shift, in px, that the lens causes on a 3×3 grid of points over the frame."""
    if camera.lens.ideal:
        return 0.0
    corners = _grid(np.array([[camera.width_px, camera.height_px]]), 3)[0]
    return float(np.abs(camera.lens.undistort(corners) - corners).max())


def _homogeneous(points: Floats) -> Floats:
    return np.column_stack([points, np.ones(len(points))])


def _grid(size: Floats, n: int) -> Floats:
    """Return a grid of n×n points (k, n², 2), row by row, over the pixels of k pictures of sizes (k, 2)."""
    # In memory in the order that `through` computes.
    return np.asarray((((_square(n) + 1) / 2).T[:, :, None] * (size.T[:, None] - 1)).T)


@lru_cache(maxsize=4)
def _square(n: int) -> Floats:
    """Return a grid of n×n points (n², 2), row by row, over the square from −1 to 1."""
    t = np.linspace(-1, 1, n)
    return np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)

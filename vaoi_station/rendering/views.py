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

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from vaoi_station.rendering.frame_pairs import Pairs

_STRAIGHT_PX = 0.02
"""Largest deviation from a homography, px, with which a single matrix represents the lens for a whole picture."""
_CORNERS = (0, 2, 8, 6)
"""Indices of the four corners, in order around the square, among 3×3 points in row order."""
_STAYS = np.eye(3)
"""Displacement of a component that follows C."""
_NEAR = 1.1
"""Factor on the size of a component in a frame, within which a frame may show it: perspective makes it larger."""


class ViewCalculator:
    """Calculator of the views of one board's components. Values that all components share are computed once."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices and cameras of one run.

        Raises:
            StateError: the run has no CAD mapping.
        """
        # Imported on first use, because Numba takes a moment to load.
        from vaoi_station.rendering.frame_pairs import Frames

        if stitch.cad_matrix is None:
            raise StateError(
                "this run has no CAD mapping, so components cannot be cut out.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        cameras = stitch.cameras(cameras)
        self._board_type, self._surface, self._cameras = board_type, stitch.surface, cameras
        px_per_mm = [c.px_per_mm for c in cameras]
        self._resolution = sum(px_per_mm) / len(px_per_mm)
        keys = [(i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None]
        key = np.array(keys, dtype=np.int_).reshape(-1, 2)
        i, row = key.T
        motion = np.array(stitch.row_motion, dtype=np.float64).reshape(-1, 3, 3)
        self._row_from_cad = (motion @ stitch.cad_matrix)[row]
        image_from_row = np.array([c.image_from_row.matrix for c in cameras])
        distance_mm = [c.working_distance_mm or math.inf for c in cameras]
        eye = np.array([(*c.foot_mm.tolist(), 1.0) for c in cameras])
        # A height decreases the third column of CAD → image (`geometry.Camera`).
        lean = (image_from_row @ eye[:, :, None])[:, :, 0] / np.array(distance_mm)[:, None]
        eye[:, 2] = [math.nan if math.isinf(mm) else mm for mm in distance_mm]
        self._eye = eye[i]
        """(f, 3) centre of the camera in row coordinates; its height is NaN if it is unknown."""
        limits = [(c.width_px, c.height_px, _bend(c), _NEAR * k) for c, k in zip(cameras, px_per_mm, strict=True)]
        limit = np.array(limits, dtype=np.float64)[i]
        self._frames = Frames(
            image_from_row[i] @ self._row_from_cad, lean[i], limit[:, :2].copy(), limit[:, 2].copy(),
            limit[:, 3] * board_type.mm_per_unit, key, *_lenses(cameras),
        )  # fmt: skip
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
        above_mm, on_top = np.zeros(len(addresses)), np.zeros(len(addresses), np.bool_)
        if tops:
            above_mm[:] = [tops.get(address, 0.0) for address in addresses]
            on_top[:] = [address in tops for address in addresses]
        surface = self._surface
        height_mm = above_mm if surface is None else above_mm + surface.height_mm(crops.footprints.center)
        pairs = self._pairs(crops, height_mm, min_coverage)
        matrices, bend_px = self._through_lenses(crops, pairs)
        tiles = self._tiles(crops, pairs, bend_px)
        columns = Columns(
            pairs.component, self._frames.key[pairs.frame], pairs.coverage, pairs.off_center, matrices,
            pairs.outline_px, tiles,
        )  # fmt: skip
        return ViewTable(addresses, crops, above_mm, on_top, columns, lambda: self._sights(crops, pairs, height_mm))

    def _crops(self, components: Sequence[Component], framing: Framing) -> Crops:
        # A picture that would be too large at the cameras' resolution gets fewer pixels: one large component must not
        # prevent the list of all components. A resolution or a margin that the caller has chosen is not changed.
        shapes = Footprints.of(components, self._board_type)
        chosen = framing.px_per_mm
        return compute_crops(shapes, shapes.fitting(self._resolution) if chosen is None else chosen, framing)

    def _pairs(self, crops: Crops, height_mm: Floats, min_coverage: float) -> Pairs:
        """Find the frames that show components, and what they show of them."""
        from vaoi_station.rendering.frame_pairs import Parts, find_pairs

        shapes = crops.footprints
        # A footprint is shown if the centres of its outermost pixels are: a pixel of the picture has one place.
        half_px = shapes.half * (crops.px_per_mm * self._board_type.mm_per_unit)[:, None]
        inner = shapes.along * np.maximum(1 - 0.5 / half_px, 0)[:, None]
        own = [self._own.get(c.address, _STAYS) for c in shapes.components] if self._own else []
        moves = np.array(own, dtype=np.float64).reshape(-1, 3, 3)
        parts = Parts(shapes.center, shapes.half, inner, height_mm, moves, crops.size, crops.cad_from_crop, crops.bare)
        return find_pairs(self._frames, parts, min_coverage)

    def _through_lenses(self, crops: Crops, pairs: Pairs) -> tuple[Floats, Floats]:
        """Replace matrices to undistorted pixels by matrices to raw ones where a matrix can represent the lens.

        Return all matrices (p, 3, 3), and the deviation of the lens from a homography (p,), px: 0 for a picture that is
        not distorted.
        """
        matrices, bend_px = pairs.image_from_crop, np.zeros(len(pairs.component))
        if not self._frames.lensed.any():
            return matrices, bend_px
        points, picture = _grid(crops.size[pairs.component], 3), pairs.picture_px
        straight = rectangle_homographies(points[:, _CORNERS], picture[:, _CORNERS])
        apart_px = np.abs(through(straight, points) - picture).max((1, 2))
        # NaN, of a picture a pixel wide, counts as bent.
        lensed = self._frames.lensed[self._frames.key[pairs.frame, 0]]
        bent = lensed & ~(apart_px <= _STRAIGHT_PX)
        bend_px[bent] = np.nan_to_num(apart_px[bent], nan=np.inf)
        return np.where((lensed & ~bent)[:, None, None], straight, matrices), bend_px

    def _tiles(self, crops: Crops, pairs: Pairs, bend_px: Floats) -> dict[int, tuple[Tile, ...]]:
        """Cut the distorted pictures among those of the pairs into tiles; the keys are the numbers of the pairs."""
        bent = np.flatnonzero(bend_px)
        if not len(bent):
            return {}
        frame, size = pairs.frame[bent], crops.size[pairs.component[bent]]
        matrices = pairs.image_from_crop[bent]
        cut = cut_tiles(matrices, size, bend_px[bent], lambda k, points: self._distorted(frame[k], points))
        return dict(zip(bent.tolist(), cut, strict=True))

    def _sights(self, crops: Crops, pairs: Pairs, height_mm: Floats) -> Sights:
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
        lean = self._frames.lean[frame]
        lift = (at[:, :2] / at[:, 2:] * lean[:, 2:] - lean[:, :2]) / at[:, 2:]
        return Sights(toward, lift)

    def _distorted(self, frame: NDArray[np.int_], points: Floats) -> Floats:
        """Return the raw pixels (p, n, 2) of undistorted pixels of p frames. `points` is overwritten."""
        of = self._frames.key[frame, 0]
        # Few cameras see one component.
        for i in set(of[self._frames.lensed[of]].tolist()):
            mine = np.flatnonzero(of == i)
            points[mine] = self._cameras[i].lens.distort(points[mine])
        return points


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


def _lenses(cameras: Sequence[Camera]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return `radial`, `lens` and `lensed` of `Frames`."""
    lensed = np.array([not c.lens.ideal for c in cameras])
    radial = np.zeros((len(cameras), max(len(c.lens.radial) for c in cameras)))
    shapes = np.zeros((len(cameras), 5))
    for n in np.flatnonzero(lensed).tolist():
        radial[n, : len(cameras[n].lens.radial)], shapes[n] = cameras[n].lens.radial, cameras[n].lens.shape
    return radial, shapes, lensed


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

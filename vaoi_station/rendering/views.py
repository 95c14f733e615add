"""The views of a component: the frames that show it, and the matrices from its picture to these frames (equation 22).

The picture (paper, section 3.4) shows the component's bounding box, upright as CAD shows it and never mirrored: CAD x
points right on the top side and left on the bottom side, and CAD "up" points up. One matrix maps the pixels of the
picture to CAD coordinates, another one to pixels of the frame. If the lens bends the picture so little that a matrix
can represent it, the matrix to the frame includes the lens. Otherwise the view is `distorted`, and the picture is made
in tiles, each with a matrix. If the board's surface is known, the footprint lies at the height of the surface.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, StateError
from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering.crops import compute_crops, fitting_resolutions

GRID = 9
"""Points per side of the grid on which the coverage of a picture is computed if the frame shows only a part of it."""
RESOLUTION_LIMITS = (0.1, 1000.0)
"""Smallest and largest resolution of pictures that a caller may request, px/mm."""
_TILE_PX = 256
"""Longest side of a tile, px.

Within a tile, a lens with a distortion of 1 px at the frame's corner bends lines by at most 0.03 px."""
_STRAIGHT_PX = 0.02
"""Largest deviation from a homography, px, with which a single matrix represents the lens for a whole picture."""
_CORNERS = (0, 2, 8, 6)
"""Indices of the four corners, in order around the square, among 3×3 points in row order."""


@dataclass(frozen=True, eq=False, slots=True)
class Tile:
    """A rectangular part of a picture: columns x0 to x1 and rows y0 to y1, ends excluded."""

    x0: int
    y0: int
    x1: int
    y1: int
    matrix: Floats
    """(3, 3) from pixels of the tile, counted from its corner, to raw pixels of the frame."""


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """The view of one component in one frame: the size of its picture, its quality, and the matrices to render it."""

    camera: int
    row: int
    width: int
    height: int
    px_per_mm: float
    coverage: float
    """Share of the picture that lies inside the frame."""
    off_center: float
    """Distance from the component's centre to the frame's centre, in half diagonals; 0 is seen from straight above."""
    crop_matrix: Floats
    """(3, 3) matrix from CAD coordinates to pixels of the picture."""
    matrix: Floats
    """(3, 3) matrix from pixels of the picture to raw pixels of the frame; to undistorted pixels if `distorted`."""
    tiles: tuple[Tile, ...]
    """Parts of the picture, each with a matrix to raw pixels, if the view is `distorted`; otherwise empty."""

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


class _Pairs(NamedTuple):
    """k pairs of a component and a frame. All frames are from one camera."""

    component: NDArray[np.int_]
    """(k,) number of the component of each pair."""
    frame: NDArray[np.int_]
    """(k,) number of the frame of each pair."""
    matrices: Floats
    """(k, 3, 3) from pixels of the picture to undistorted pixels of the frame."""
    size: Floats
    """(k, 2) width and height of the picture."""
    crop_from_cad: Floats
    """(k, 3, 3) from CAD coordinates to pixels of the picture."""


class ViewCalculator:
    """Calculator of the views of one board's components. Values that all components share are computed once."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Store the matrices and cameras of one run.

        Raises:
            StateError: the run has no CAD mapping.
        """
        if stitch.tester_from_cad is None:
            raise StateError(
                "this run has no CAD mapping, so components cannot be cut out.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        cameras = stitch.cameras(cameras)
        self._board_type, self._surface, self._cameras = board_type, stitch.surface, cameras
        self._resolution = float(np.mean([c.px_per_mm for c in cameras]))
        self._keys = [
            (i, j) for i, rows in enumerate(stitch.image_matrices) for j, m in enumerate(rows) if m is not None
        ]
        self._camera = np.array([i for i, _ in self._keys], dtype=np.int_)
        row_from_cad = np.array([stitch.row_motion[j] @ stitch.tester_from_cad.matrix for _, j in self._keys])
        image_from_row = np.array([c.image_from_row.matrix for c in cameras])
        self._image_from_cad = image_from_row[self._camera] @ row_from_cad.reshape(-1, 3, 3)
        feet = np.array([(*c.foot_mm, 1.0) for c in cameras])
        lean = (image_from_row @ feet[:, :, None])[:, :, 0] / [[c.working_distance_mm or np.inf] for c in cameras]
        self._lean = lean[self._camera]
        """(f, 3) for f frames: decrease of the third column of CAD → image per mm of height (`geometry.Camera`)."""
        self._size = np.array([(c.width_px, c.height_px) for c in cameras], dtype=np.float64)[self._camera]
        self._bend = np.array([_bend(c) for c in cameras])[self._camera]

    def compute(
        self, component: Component, *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> tuple[View, ...]:
        """Compute the views of one component; see `compute_views`."""
        return self.compute_all([component], px_per_mm=px_per_mm, min_coverage=min_coverage)[component.address]

    def compute_all(
        self, components: Sequence[Component], *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> dict[str, tuple[View, ...]]:
        """Compute the views of many components at once; the keys are the components' addresses."""
        require_resolution(px_per_mm)
        require_coverage(min_coverage)
        if not components:
            return {}
        # A picture that would be too large at the cameras' resolution gets fewer pixels: one large component must not
        # prevent the list of all components. A resolution that the caller has chosen is not changed.
        resolution = (
            fitting_resolutions(components, self._board_type, self._resolution)
            if px_per_mm is None
            else np.full(len(components), float(px_per_mm))
        )
        crops = compute_crops(components, self._board_type, resolution)
        matrices = self._matrices(components, crops.cad_from_crop)
        ends = _project(matrices, _grid(crops.size, 3)[:, _CORNERS])
        # A cheap test of corners comes first, since few frames show a component. The margin allows for lens distortion.
        spread = self._bend[None, :, None]
        touching = (ends.max(2) >= -spread).all(2) & (ends.min(2) <= self._size - 1 + spread).all(2)
        component, frame = np.nonzero(touching)
        least = max(min_coverage, 1e-9)
        found: list[list[View]] = [[] for _ in components]
        for i, camera in enumerate(self._cameras):
            mine = self._camera[frame] == i
            k, f = component[mine], frame[mine]
            if len(k):
                pairs = _Pairs(k, f, matrices[k, f], crops.size[k], crops.crop_from_cad[k])
                for component_number, view in self._views_of_camera(camera, pairs, resolution, least):
                    found[component_number].append(view)
        for views in found:
            # Coverages are rounded, so that the order does not depend on the last digits of nearly equal values.
            views.sort(key=lambda v: (-round(v.coverage, 3), round(v.off_center, 6), v.row, v.camera))
        return {c.address: tuple(views) for c, views in zip(components, found, strict=True)}

    def _views_of_camera(
        self, camera: Camera, pairs: _Pairs, resolution: Floats, min_coverage: float
    ) -> Iterator[tuple[int, View]]:
        """Compute the views in frames of one camera; yield each with the number of the component that it shows."""
        component, frame, matrices, size, crop_from_cad = pairs
        points = _grid(size, 3)
        raw = _through(matrices, points)
        bent = np.zeros(len(matrices), dtype=bool)
        if not camera.lens.ideal:
            raw = camera.lens.distort(raw)
            straight = _homographies(points[:, _CORNERS], raw[:, _CORNERS])
            bent = ~(np.abs(_through(straight, points) - raw).max((1, 2)) <= _STRAIGHT_PX)
            matrices = np.where(bent[:, None, None], matrices, straight)
        coverage = np.asarray(camera.sees(raw).all(1), dtype=np.float64)
        # Most pictures lie completely inside the frame. Only the others are sampled finely.
        partial = np.flatnonzero(coverage < 1)
        at = _through(matrices[partial], _grid(size[partial], GRID))
        at[bent[partial]] = camera.lens.distort(at[bent[partial]])
        coverage[partial] = camera.sees(at).mean(1)
        shown = np.flatnonzero(bent & (coverage >= min_coverage))
        tiles = (
            dict(zip(shown.tolist(), _tiles(camera, matrices[shown], size[shown]), strict=True)) if len(shown) else {}
        )
        off = np.hypot(*(raw[:, 4] - camera.center_px).T) / math.hypot(*camera.center_px)
        whole = size.astype(int).tolist()
        for n in np.flatnonzero(coverage >= min_coverage).tolist():
            (i, j), k = self._keys[frame[n]], int(component[n])
            w, h = whole[n]
            share, middle = float(coverage[n]), float(off[n])
            view = View(
                i, j, w, h, float(resolution[k]), share, middle, crop_from_cad[n], matrices[n], tiles.get(n, ())
            )
            yield k, view

    def _matrices(self, components: Sequence[Component], cad_from_crop: Floats) -> Floats:
        """Build the matrices (k, f, 3, 3) from the pictures of k components to undistorted pixels of f frames.

        Each matrix holds in the plane of the component's footprint, at the height of the board's surface.
        """
        image_from_cad = np.repeat(self._image_from_cad[None], len(components), 0)
        if self._surface is not None:
            heights = self._surface.height_mm(np.array([c.center for c in components]))
            image_from_cad[..., 2] -= heights[:, None, None] * self._lean[None]
        return np.asarray(image_from_cad @ cad_from_crop[:, None], dtype=np.float64)


def compute_views(
    component: Component,
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    *,
    px_per_mm: float | None = None,
    min_coverage: float = 0.5,
) -> tuple[View, ...]:
    """Compute the views of a component: highest coverage first, then smallest distance from the frame's centre.

    Args:
        component: a component of the board type.
        board_type: board type of the run; its unit, axes and side are used.
        stitch: result of the run; its matrices and surface are used.
        cameras: cameras of the calibration with which the run was stitched.
        px_per_mm: resolution of the pictures; by default the mean resolution of the cameras.
        min_coverage: least share of the picture inside a frame; frames that show less are left out.

    Raises:
        StateError: the run has no CAD mapping.
        InputError: the picture would be too large, or resolution or coverage is outside its limits.
    """
    return ViewCalculator(board_type, stitch, cameras).compute(
        component, px_per_mm=px_per_mm, min_coverage=min_coverage
    )


def require_resolution(px_per_mm: object) -> None:
    """Raise InputError unless a resolution is a number within its limits, or None for the resolution of the cameras."""
    if px_per_mm is not None and not _is_within(px_per_mm, *RESOLUTION_LIMITS):
        limit = f"None or a number from {RESOLUTION_LIMITS[0]:g} to {RESOLUTION_LIMITS[1]:g}"
        raise InputError.field("component images", "px_per_mm", px_per_mm, limit)


def require_coverage(min_coverage: object) -> None:
    """Raise InputError unless a coverage is a number from 0 to 1."""
    if not _is_within(min_coverage, 0.0, 1.0):
        raise InputError.field("component images", "min_coverage", min_coverage, "a number from 0 to 1")


def _is_within(value: object, least: float, most: float) -> bool:
    """Return whether a value is a number within limits; NaN and booleans are not."""
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return real and bool(least <= value <= most)  # type: ignore[operator]  # it is a number here


def _bend(camera: Camera) -> float:
    """Compute the largest shift, in px, that the lens causes on a 3×3 grid of points over the frame."""
    corners = _grid(np.array([[camera.width_px, camera.height_px]]), 3)[0]
    return float(np.abs(camera.lens.undistort(corners) - corners).max())


def _grid(size: Floats, n: int) -> Floats:
    """Return a grid of n×n points (k, n², 2), row by row, over the pixels of k pictures of sizes (k, 2)."""
    return np.asarray(_unit_grid(n) * (size[:, None] - 1))


@lru_cache(maxsize=4)
def _unit_grid(n: int) -> Floats:
    t = np.linspace(0, 1, n)
    return np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)


def _project(matrices: Floats, points: Floats) -> Floats:
    """Project n points of each of k pictures, (k, n, 2), by matrices (k, f, 3, 3) to f frames: (k, f, n, 2)."""
    q = matrices[..., :2] @ points[:, None].swapaxes(2, 3) + matrices[..., 2:]
    return np.asarray((q[:, :, :2] / q[:, :, 2:]).swapaxes(2, 3))


def _through(matrices: Floats, points: Floats) -> Floats:
    """Project n points of each of k pictures, (k, n, 2), by one matrix per picture, (k, 3, 3), to pixels (k, n, 2)."""
    q = points @ matrices[:, :, :2].swapaxes(1, 2) + matrices[:, None, :, 2]
    return np.asarray(q[..., :2] / q[..., 2:])


def _tiles(camera: Camera, matrices: Floats, size: Floats) -> list[tuple[Tile, ...]]:
    """Cut each picture into tiles, whose corners are mapped through the lens exactly; return the tiles of each."""
    lines = [[_cuts(int(v)) for v in wh] for wh in size]
    nodes = [np.stack(np.meshgrid(x, y), -1).astype(np.float64) - 0.5 for x, y in lines]
    ahead = [apply(m, n).reshape(-1, 2) for m, n in zip(matrices, nodes, strict=True)]
    raw = np.split(camera.lens.distort(np.concatenate(ahead)), np.cumsum([len(a) for a in ahead])[:-1])
    source = [_cells(n) for n in nodes]
    source = [s - (s[:, :1] + 0.5) for s in source]
    target = [_cells(r.reshape(n.shape)) for r, n in zip(raw, nodes, strict=True)]
    found = iter(_homographies(np.concatenate(source), np.concatenate(target)))
    return [
        tuple(Tile(a, b, c, d, next(found)) for b, d in pairwise(y.tolist()) for a, c in pairwise(x.tolist()))
        for x, y in lines
    ]


def _cuts(length: int) -> NDArray[np.int_]:
    """Return the positions, both ends included, at which a side of this length is cut into tiles."""
    return np.asarray(np.linspace(0, length, -(-length // _TILE_PX) + 1).round(), dtype=np.int_)


def _cells(nodes: Floats) -> Floats:
    """Collect the four corners of each of the k cells of a grid of nodes (rows, columns, 2), going round: (k, 4, 2)."""
    corners = (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1])
    return np.stack([nodes[c] for c in corners], 2).reshape(-1, 4, 2)


def _homographies(source: Floats, target: Floats) -> Floats:
    """Compute k homographies (k, 3, 3), each from four points `source` (k, 4, 2) to four points `target` (k, 4, 2)."""
    x, y = source[..., 0], source[..., 1]
    one, nil = np.ones_like(x), np.zeros_like(x)
    u, v = target[..., 0], target[..., 1]
    rows_u = np.stack([x, y, one, nil, nil, nil, -u * x, -u * y], -1)
    rows_v = np.stack([nil, nil, nil, x, y, one, -v * x, -v * y], -1)
    system = np.concatenate([rows_u, rows_v], 1)
    flat = (x.max(1) - x.min(1) < 1) | (y.max(1) - y.min(1) < 1)
    # A picture one pixel wide or high has no four distinct corners. Its matrix is NaN, and the caller then keeps the
    # matrix without lens.
    system[flat] = np.eye(8)
    h = np.linalg.solve(system, np.concatenate([u, v], 1)[..., None])[..., 0]
    h[flat] = np.nan
    return np.concatenate([h, np.ones((len(h), 1))], 1).reshape(-1, 3, 3)

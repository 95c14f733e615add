"""The views of a component: the frames that show it, and the matrices from its picture to them (equation 22).

The picture (section 3.4) shows the component's bounding box, upright as CAD shows it: never mirrored, CAD x to the
right on the top side and to the left on the bottom side, CAD "up" up. One matrix maps its pixels to CAD and back, one
to the pixels of the frame. Where the lens bends so little over the picture that a matrix represents it, it is part of
that matrix; elsewhere the view is `distorted` and comes in tiles. Where the board's surface is known, the footprint
lies on it.
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

from vaoi_station.errors import StateError
from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering.crops import compute_crops

GRID = 9
"""Points per side at which the coverage of a picture that is cut off is computed."""
_TILE_PX = 256
"""Side of a tile; over it a lens that bends by a pixel at the frame's corner is straight to 0.03 px."""
_STRAIGHT_PX = 0.02
"""Largest bending over a picture that goes into the matrix."""
_CORNERS = (0, 2, 8, 6)
"""The corners among 3×3 points."""


@dataclass(frozen=True, eq=False, slots=True)
class Tile:
    """Part of a picture: its columns and rows (ends excluded), and the matrix from its pixels to raw pixels."""

    x0: int
    y0: int
    x1: int
    y1: int
    matrix: Floats


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """One component in one frame."""

    camera: int
    row: int
    width: int
    height: int
    px_per_mm: float
    coverage: float
    """Share of the picture that lies inside the frame."""
    off_center: float
    """Distance of the component's middle from the frame's, in half diagonals; small means seen from straight above."""
    crop_matrix: Floats
    """(3, 3) CAD coordinates to the picture's pixels."""
    matrix: Floats
    """(3, 3) the picture's pixels to the frame's: raw pixels, or undistorted ones where `distorted`."""
    tiles: tuple[Tile, ...]
    """Where `distorted`, the parts of the picture, each with its own matrix to raw pixels; else empty."""

    @property
    def distorted(self) -> bool:
        """Whether the lens bends more over this picture than a matrix represents."""
        return bool(self.tiles)

    @property
    def crop_from_cad(self) -> Projective:
        """Transform from CAD coordinates to the picture's pixels."""
        return Projective(self.crop_matrix, System.CROP, System.CAD)

    @property
    def cad_from_crop(self) -> Projective:
        """Transform from the picture's pixels to CAD coordinates."""
        return self.crop_from_cad.inverse()

    @property
    def image_from_crop(self) -> Projective:
        """`matrix` as a transform."""
        return Projective(self.matrix, System.IMAGE, System.CROP)


class _Pairs(NamedTuple):
    """Pairs of a component and a frame of one camera."""

    component: NDArray[np.int_]
    frame: NDArray[np.int_]
    matrices: Floats
    """(k, 3, 3) picture to undistorted pixels."""
    size: Floats
    crop_from_cad: Floats


class ViewCalculator:
    """Computes views of the components of one stitched board; what components share is computed once."""

    def __init__(self, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera]) -> None:
        """Take matrices and cameras of one run.

        Raises:
            StateError: the run has no CAD mapping.
        """
        if stitch.tester_from_cad is None:
            raise StateError(
                "this run has no CAD mapping, so components cannot be cut out.",
                action="; ".join(stitch.reasons),
                code="no-cad-mapping",
            )
        self._board_type, self._surface, self._cameras = board_type, stitch.surface, tuple(cameras)
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
        """(f, 3) decrease of the third column of CAD → image per mm of height (`geometry.Camera`)."""
        self._size = np.array([(c.width_px, c.height_px) for c in cameras], dtype=np.float64)[self._camera]
        self._bend = np.array([_bend(c) for c in cameras])[self._camera]

    def compute(
        self, component: Component, *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> tuple[View, ...]:
        """Compute the views of one component; see `views_of`."""
        return self.compute_all([component], px_per_mm=px_per_mm, min_coverage=min_coverage)[component.address]

    def compute_all(
        self, components: Sequence[Component], *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> dict[str, tuple[View, ...]]:
        """Compute the views of many components at once, by address."""
        if not components:
            return {}
        resolution = px_per_mm or self._resolution
        crops = compute_crops(components, self._board_type, resolution)
        matrices = self._matrices(components, crops.cad_from_crop)
        ends = _project(matrices, _grid(crops.size, 3)[:, _CORNERS])
        # A cheap test by corners first, widened by the lens: most components are in few of the frames.
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
            # Rounded, so that the order does not depend on the last digits of equal coverages.
            views.sort(key=lambda v: (-round(v.coverage, 3), round(v.off_center, 6), v.row, v.camera))
        return {c.address: tuple(views) for c, views in zip(components, found, strict=True)}

    def _views_of_camera(
        self, camera: Camera, pairs: _Pairs, resolution: float, min_coverage: float
    ) -> Iterator[tuple[int, View]]:
        """Compute the views of one camera, each with the number of its component."""
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
        # Most views lie inside as a whole; only the others are sampled finely.
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
            view = View(i, j, w, h, resolution, share, middle, crop_from_cad[n], matrices[n], tiles.get(n, ()))
            yield k, view

    def _matrices(self, components: Sequence[Component], cad_from_crop: Floats) -> Floats:
        """Build the matrices (k, f, 3, 3) from pictures to undistorted pixels, in the plane of each footprint."""
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
    """Compute the views of a component, best first: by coverage, then by distance from the frame's middle.

    Args:
        component: of the board type.
        board_type: gives unit, axes and side.
        stitch: matrices of the run.
        cameras: of the same calibration.
        px_per_mm: resolution of the pictures; by default the cameras'.
        min_coverage: frames that show less of the box are left out.

    Raises:
        StateError: the run has no CAD mapping.
        InputError: the picture would be too large.
    """
    return ViewCalculator(board_type, stitch, cameras).compute(
        component, px_per_mm=px_per_mm, min_coverage=min_coverage
    )


def _bend(camera: Camera) -> float:
    """Compute the largest shift in px of a corner of the frame by its lens."""
    corners = _grid(np.array([[camera.width_px, camera.height_px]]), 3)[0]
    return float(np.abs(camera.lens.undistort(corners) - corners).max())


def _grid(size: Floats, n: int) -> Floats:
    """Spread pixels (k, n², 2) evenly over pictures of sizes (k, 2), border pixels included, row by row."""
    return np.asarray(_unit_grid(n) * (size[:, None] - 1))


@lru_cache(maxsize=4)
def _unit_grid(n: int) -> Floats:
    t = np.linspace(0, 1, n)
    return np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)


def _project(matrices: Floats, points: Floats) -> Floats:
    """Project points (k, n, 2) by matrices (k, f, 3, 3) to pixels (k, f, n, 2)."""
    q = matrices[..., :2] @ points[:, None].swapaxes(2, 3) + matrices[..., 2:]
    return np.asarray((q[:, :, :2] / q[:, :, 2:]).swapaxes(2, 3))


def _through(matrices: Floats, points: Floats) -> Floats:
    """Project points (k, n, 2) by matrices (k, 3, 3)."""
    q = points @ matrices[:, :, :2].swapaxes(1, 2) + matrices[:, None, :, 2]
    return np.asarray(q[..., :2] / q[..., 2:])


def _tiles(camera: Camera, matrices: Floats, size: Floats) -> list[tuple[Tile, ...]]:
    """Cut pictures into tiles whose corners pass through the lens exactly, all pictures at once."""
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
    """Return the cuts of a side into tiles, both ends included."""
    return np.asarray(np.linspace(0, length, -(-length // _TILE_PX) + 1).round(), dtype=np.int_)


def _cells(nodes: Floats) -> Floats:
    """Collect the corners (k, 4, 2), going round, of the cells of a grid of nodes (rows, columns, 2)."""
    corners = (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1])
    return np.stack([nodes[c] for c in corners], 2).reshape(-1, 4, 2)


def _homographies(source: Floats, target: Floats) -> Floats:
    """Solve for matrices (k, 3, 3) that take four points (k, 4, 2) to four others; eight equations each."""
    x, y = source[..., 0], source[..., 1]
    one, nil = np.ones_like(x), np.zeros_like(x)
    u, v = target[..., 0], target[..., 1]
    rows_u = np.stack([x, y, one, nil, nil, nil, -u * x, -u * y], -1)
    rows_v = np.stack([nil, nil, nil, x, y, one, -v * x, -v * y], -1)
    system = np.concatenate([rows_u, rows_v], 1)
    flat = (x.max(1) - x.min(1) < 1) | (y.max(1) - y.min(1) < 1)
    # Pictures of one pixel have no four corners; their matrix is NaN, and the caller keeps the one without lens.
    system[flat] = np.eye(8)
    h = np.linalg.solve(system, np.concatenate([u, v], 1)[..., None])[..., 0]
    h[flat] = np.nan
    return np.concatenate([h, np.ones((len(h), 1))], 1).reshape(-1, 3, 3)

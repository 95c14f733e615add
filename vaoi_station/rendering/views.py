"""Which frames see a component, and the matrices from its picture to them (section 3.4, equation 22).

The picture shows the component's bounding box, upright as CAD shows it: never mirrored, CAD x to the
right on the top side and to the left on the bottom side, CAD "up" up. One matrix maps its pixels to
CAD and back; where lenses distort, the matrix from picture to frame gives undistorted pixels and the
renderer bends them. Where the board's surface is known, the footprint lies on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, StateError
from vaoi_station.geometry import Camera, Projective, System
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component, Stitch

MOST_PIXELS = 16_000_000
"""No temporary image is larger; ask for fewer pixels per mm."""
GRID = 9
"""Points per side at which coverage and distortion of a picture are computed."""
_LENS_MARGIN_PX = 50.0
"""No lens bends the border of a frame by more."""


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """How one frame shows one component."""

    camera: int
    row: int
    width: int
    height: int
    px_per_mm: float
    coverage: float
    """Share of the picture that lies inside the frame."""
    off_center: float
    """Distance of the component's middle from the frame's, in half diagonals: small is seen straight from above."""
    crop_from_cad: Projective
    """CAD coordinates to the picture's pixels."""
    matrix: Floats
    """(3, 3) the picture's pixels to undistorted pixels of the frame."""
    raw_nodes: Floats | None
    """(9, 9, 2) raw pixels of a grid over the picture, border to border; None where the lens does not bend."""

    @property
    def distorted(self) -> bool:
        """Whether the frame's lens bends: then `matrix` and raw pixels differ."""
        return self.raw_nodes is not None

    @property
    def cad_from_crop(self) -> Projective:
        """CAD coordinates of the picture's pixels."""
        return self.crop_from_cad.inverse()

    @property
    def image_from_crop(self) -> Projective:
        """`matrix` as a transform."""
        return Projective(self.matrix, System.IMAGE, System.CROP)


class Album:
    """The views of one stitched board: what its components share is computed once."""

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
        frames = np.array([i for i, _ in self._keys], dtype=np.int_)
        row_from_cad = np.array([stitch.row_motion[j] @ stitch.tester_from_cad.matrix for _, j in self._keys])
        image_from_row = np.array([c.image_from_row.matrix for c in cameras])
        self._image_from_cad = image_from_row[frames] @ row_from_cad.reshape(-1, 3, 3)
        feet = np.array([(*c.foot_mm, 1.0) for c in cameras])
        lean = (image_from_row @ feet[:, :, None])[:, :, 0] / [[c.working_distance_mm or np.inf] for c in cameras]
        self._lean = lean[frames]
        """(f, 3) change of the third column of CAD → image per mm of height, negated (`geometry.Camera`)."""
        self._size = np.array([(c.width_px, c.height_px) for c in cameras], dtype=np.float64)[frames]
        self._ideal = np.array([c.lens.ideal for c in cameras])[frames]

    def views(
        self, component: Component, *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> tuple[View, ...]:
        """Every frame that sees a component; see `views_of`."""
        return self.board([component], px_per_mm=px_per_mm, min_coverage=min_coverage)[component.address]

    def board(
        self, components: Sequence[Component], *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> dict[str, tuple[View, ...]]:
        """The views of many components at once, by address."""
        if not components:
            return {}
        resolution = px_per_mm or self._resolution
        crops = [crop_of(c, self._board_type, resolution) for c in components]
        matrices = self._matrices(components, np.array([m.inverse().matrix for _, _, m in crops]))
        size = np.array([(w, h) for w, h, _ in crops], dtype=np.float64)
        ends = _project(matrices, _ends(size))
        spread = _LENS_MARGIN_PX * ~self._ideal[None, :, None]
        touching = (ends.max(2) >= -spread).all(2) & (ends.min(2) <= self._size - 1 + spread).all(2)
        inside = (ends.min(2) >= 0).all(2) & (ends.max(2) <= self._size - 1).all(2) & self._ideal
        middle = _project(matrices, (size[:, None] - 1) / 2)[:, :, 0]
        nodes, coverage = self._nodes(matrices, size, touching & ~inside)
        coverage[inside] = 1.0
        found: dict[str, tuple[View, ...]] = {}
        for k, (component, (width, height, crop_from_cad)) in enumerate(zip(components, crops, strict=True)):
            views = []
            for f in np.flatnonzero(touching[k] & (coverage[k] >= max(min_coverage, 1e-9))):
                (i, j), share = self._keys[f], float(coverage[k, f])
                cx, cy = self._cameras[i].center_px
                off = math.hypot(middle[k, f, 0] - cx, middle[k, f, 1] - cy) / math.hypot(cx, cy)
                bent = None if self._ideal[f] else nodes[k, int(f)]
                views.append(View(i, j, width, height, resolution, share, off, crop_from_cad, matrices[k, f], bent))
            views.sort(key=lambda v: (-round(v.coverage, 3), round(v.off_center, 6), v.row, v.camera))
            found[component.address] = tuple(views)
        return found

    def _nodes(
        self, matrices: Floats, size: Floats, wanted: NDArray[np.bool_]
    ) -> tuple[dict[tuple[int, int], Floats], Floats]:
        """Raw pixels of each picture's grid in the frames where they are wanted, and the share inside the frame."""
        nodes: dict[tuple[int, int], Floats] = {}
        coverage = np.zeros(wanted.shape)
        for i, camera in enumerate(self._cameras):
            mine = np.array([key[0] == i for key in self._keys])
            at = np.argwhere(wanted & mine)
            if not len(at):
                continue
            k, f = at.T
            raw = camera.lens.distort(_through(matrices[k, f], _grid(size[k])))
            coverage[k, f] = camera.sees(raw).mean(1)
            nodes |= {(int(a), int(b)): r.reshape(GRID, GRID, 2) for a, b, r in zip(k, f, raw, strict=True)}
        return nodes, coverage

    def _matrices(self, components: Sequence[Component], cad_from_crop: Floats) -> Floats:
        """Picture to undistorted pixels of every frame, (k, f, 3, 3), in the plane of each footprint."""
        image_from_cad = np.repeat(self._image_from_cad[None], len(components), 0)
        if self._surface is not None:
            heights = self._surface.height_mm(np.array([c.center for c in components]))
            image_from_cad[..., 2] -= heights[:, None, None] * self._lean[None]
        return np.asarray(image_from_cad @ cad_from_crop[:, None], dtype=np.float64)


def views_of(
    component: Component,
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    *,
    px_per_mm: float | None = None,
    min_coverage: float = 0.5,
) -> tuple[View, ...]:
    """Every frame that sees a component, the best first: those that show all of it, then those nearest to their middle.

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
    return Album(board_type, stitch, cameras).views(component, px_per_mm=px_per_mm, min_coverage=min_coverage)


def crop_of(component: Component, board_type: BoardType, px_per_mm: float) -> tuple[int, int, Projective]:
    """Width and height of a component's picture, and the transform from CAD to its pixels.

    Pixel sizes are areas: the edges of the box are the outer edges of the border pixels, so the centre
    of pixel (0, 0) lies half a pixel inside.
    """
    corners = board_type.footprint(component)
    low, high = corners.min(0), corners.max(0)
    scale = px_per_mm * board_type.mm_per_unit
    width, height = (max(round(float(v) * scale), 1) for v in high - low)
    if width * height > MOST_PIXELS:
        limit = f"small enough for {MOST_PIXELS / 1e6:.0f} megapixels (this would be {width}×{height})"
        raise InputError.field(component.address, "px_per_mm", px_per_mm, limit)
    x_right, y_down = board_type.side == "top", board_type.y_axis == "down"
    sx = width / (high[0] - low[0]) * (1 if x_right else -1)
    sy = height / (high[1] - low[1]) * (1 if y_down else -1)
    x0, y0 = (low if x_right else high)[0], (low if y_down else high)[1]
    matrix = np.array([[sx, 0, -sx * x0 - 0.5], [0, sy, -sy * y0 - 0.5], [0, 0, 1.0]])
    return width, height, Projective(matrix, System.CROP, System.CAD)


def _ends(size: Floats) -> Floats:
    """Centres of the corner pixels (k, 4, 2) of pictures of sizes (k, 2)."""
    w, h = (size - 1).T
    nil = np.zeros_like(w)
    return np.stack([np.stack(p, -1) for p in ((nil, nil), (w, nil), (w, h), (nil, h))], 1)


def _project(matrices: Floats, points: Floats) -> Floats:
    """Pixels (k, f, n, 2) of points (k, n, 2) by matrices (k, f, 3, 3)."""
    q = matrices[..., :2] @ points[:, None].swapaxes(2, 3) + matrices[..., 2:]
    return np.asarray((q[:, :, :2] / q[:, :, 2:]).swapaxes(2, 3))


def _grid(size: Floats) -> Floats:
    """Pixels (k, 81, 2) spread evenly over pictures of sizes (k, 2), border pixels included, row by row."""
    t = np.linspace(0, 1, GRID)
    unit = np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)
    return np.asarray(unit * (size[:, None] - 1))


def _through(matrices: Floats, points: Floats) -> Floats:
    """Points (k, n, 2) through matrices (k, 3, 3)."""
    q = points @ matrices[:, :, :2].swapaxes(1, 2) + matrices[:, None, :, 2]
    return np.asarray(q[..., :2] / q[..., 2:])

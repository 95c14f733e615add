"""The orientation of the board: as expected, or turned by 180°. Two fiducials often fit both orientations.

If the fiducials do not decide the orientation, the pictures do (docs/decisions/0004). The outline is a step of grey
level between board and belt, and components have edges where the CAD data place them. The contrast of these edges is
measured for the board as placed and for the board turned by 180° on the same fiducials.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.frame_visibility import FrameArrays
from vaoi_station.stitching.matching.scene import Scene

_PIECE_MM = 4.0
"""Length over which an edge is averaged, so that texture cancels and the edge stays."""
_SAMPLES, _DEPTHS = 10, 2
_NEAR_MM, _FAR_MM = 0.12, 0.45
"""Distances from an edge at which its two sides are compared."""
_APART_MM = 0.4
"""Edges of the two orientations that lie closer together than this are not compared."""
_CLEAR = {"outline": 1.5, "components": 2.5}
_LEAST_STEP = {"outline": 5.0, "components": 10.0}
"""Least contrast, in grey levels, from which on the edges of a kind can decide the orientation.

In addition, the contrasts of the two orientations must differ by the factor in `_CLEAR`. Components are weaker evidence
than the outline, so their limits are higher."""
_LEAST_PIECES, _MOST_PIECES = 6, 48
_LEAST_OUTLINE = 3.0
"""Least contrast of a visible outline, in grey levels. Noise alone gives less than 1."""


@dataclass(frozen=True)
class Orientation:
    """Median edge contrast in grey levels for both orientations, and the kind of edges on which it was measured."""

    evidence: str
    as_placed: float
    turned: float

    @property
    def contradicts(self) -> bool:
        """Whether the edges show that the board lies turned by 180°."""
        return _stands_out(self.evidence, self.turned, self.as_placed)

    @property
    def confirms(self) -> bool:
        """Whether the edges show that the board lies as placed."""
        return _stands_out(self.evidence, self.as_placed, self.turned)


def _stands_out(evidence: str, one: float, other: float) -> bool:
    return one > _CLEAR[evidence] * other and one > _LEAST_STEP[evidence]


def compare_orientations(
    board_type: BoardType,
    placed: Floats,
    turned: Floats,
    scene: Scene,
    motion: Motion,
) -> Orientation | None:
    """Compare the edge contrast of the board as placed with that of the board turned by 180°.

    Args:
        board_type: board type, whose outline and components are used.
        placed: C as found, (3, 3) from CAD to tester coordinates.
        turned: C of the turned board on the same fiducials, (3, 3).
        scene: the cameras and frames.
        motion: motion of the rows.

    Returns:
        The first evidence that decides: the outline, else the components. If neither decides, the last evidence
        that was measured. None if there was nothing to compare.
    """
    best, frames = None, FrameArrays.of(scene, motion)
    for evidence, lines in (("outline", outline_polygons), ("components", _footprints)):
        pieces = straight_pieces(lines(board_type), board_type.mm_per_unit)
        if not len(pieces):
            continue
        apart = _apart(pieces, placed, turned)
        if apart.sum() < _LEAST_PIECES:
            # A board that is symmetric about its fiducials has the same edges in both orientations.
            continue
        a = _steps(pieces[apart], placed, frames)
        b = _steps(pieces[apart], turned, frames)
        if min(len(a), len(b)) < _LEAST_PIECES:
            continue
        # The median is used because texture and neighbouring components disturb single pieces.
        best = Orientation(evidence, float(np.median(a)), float(np.median(b)))
        if best.contradicts or best.confirms:
            return best
    return best


@dataclass(frozen=True)
class OutlineContrast:
    """Median contrast, in grey levels, along the board's outline as placed, and the number of measured pieces."""

    contrast: float
    pieces: int

    @property
    def visible(self) -> bool:
        """Whether the pictures show an edge where the board should end."""
        return self.contrast >= _LEAST_OUTLINE


def measure_outline_contrast(
    board_type: BoardType, placed: Floats, scene: Scene, motion: Motion
) -> OutlineContrast | None:
    """Measure the contrast along the outline where C (`placed`) puts it; None if too little is in view."""
    pieces = straight_pieces(outline_polygons(board_type), board_type.mm_per_unit)
    pieces = pieces[subsample_pieces(len(pieces))]
    steps = _steps(pieces, placed, FrameArrays.of(scene, motion)) if len(pieces) else np.zeros(0)
    return OutlineContrast(float(np.median(steps)), len(steps)) if len(steps) >= _LEAST_PIECES else None


def subsample_pieces(pieces: int) -> NDArray[np.int_]:
    """Choose pieces of an outline: return the indices of all of them or, if they are many, of an even subset."""
    # 48 pieces give the position of the outline more precisely than boards are cut. More would only take more time.
    return np.unique(np.linspace(0, pieces - 1, min(pieces, _MOST_PIECES)).round().astype(np.int_))


def outline_polygons(board_type: BoardType) -> list[Floats]:
    """Return the outline as a list of polygons (k, 2) in CAD coordinates: one polygon, or none if it is unknown."""
    if board_type.outline is None:
        return []
    points = np.array(board_type.outline, dtype=np.float64)
    if len(points) == 2:
        low, high = points.min(0), points.max(0)
        points = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return [points]


def _footprints(board_type: BoardType) -> list[Floats]:
    return [board_type.footprint(c) for c in board_type.components]


def straight_pieces(polygons: list[Floats], mm_per_unit: float) -> Floats:
    """Cut closed polygons into k straight pieces of a few mm, (k, 2, 2) start and end; shorter edges are not cut."""
    if not polygons:
        return np.zeros((0, 2, 2))
    a, b = np.concatenate(polygons), np.concatenate([np.roll(p, -1, 0) for p in polygons])
    count = np.maximum((np.hypot(*(b - a).T) * mm_per_unit / _PIECE_MM).astype(int), 1)
    of, k = np.repeat(np.arange(len(a)), count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ends = np.stack([k, k + 1], -1) / count[of, None]
    return np.asarray(a[of, None] + ends[..., None] * (b - a)[of, None])


def _apart(pieces: Floats, placed: Floats, turned: Floats) -> NDArray[np.bool_]:
    """Return for each of k pieces whether it is far enough from all pieces of the other orientation to be compared."""
    a, b = apply(placed, pieces), apply(turned, pieces)
    along = a[:, 1] - a[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    middle_a, middle_b = a.mean(1), b.mean(1)
    offset = np.abs(((middle_b[None] - middle_a[:, None]) * normal[:, None]).sum(-1))
    length = np.abs(((middle_b[None] - middle_a[:, None]) * (normal[:, ::-1] * (1, -1))[:, None]).sum(-1))
    beside = length < _PIECE_MM
    nearest = np.where(beside, offset, np.inf).min(1)
    return np.asarray(nearest > _APART_MM)


def _steps(pieces: Floats, cad_matrix: Floats, frames: FrameArrays) -> Floats:
    """Measure the contrast in grey levels across each piece (k, 2, 2); pieces that no frame shows are left out."""
    board = apply(cad_matrix, pieces)
    number = frames.nearest(board.mean(1))
    px = frames.project(number, _both_sides(board))
    step = frames.read_samples(number, 1, lambda image, mine: _contrast(image, px[mine]))
    return np.asarray(step[np.isfinite(step)])


@compiled
def _contrast(image: NDArray[np.uint8], px: Floats) -> Floats:
    """Compute k contrasts (k, 1) from s sample points each, at raw pixels `px` (k, s, 2) of an image.

    A contrast is the absolute difference between the mean grey level of the first and of the second half of the points.
    It is NaN if one of the points lies outside the image.
    """
    h, w = image.shape
    count = px.shape[1]
    out = np.empty((len(px), 1))
    for k in range(len(px)):
        total = 0.0
        for s in range(count):
            x, y = px[k, s, 0], px[k, s, 1]
            if not (0 <= x <= w - 1 and 0 <= y <= h - 1):
                total = np.nan
                break
            j, i = min(int(x), w - 2), min(int(y), h - 2)
            u, v = x - j, y - i
            above = image[i, j] * (1 - u) + image[i, j + 1] * u
            below = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
            grey = above * (1 - v) + below * v
            total += grey if 2 * s < count else -grey
        out[k, 0] = 2 * abs(total) / count
    return out


def _both_sides(board: Floats) -> Floats:
    """Lay s sample points along both sides of each straight piece (k, 2, 2): (k, s, 2), all of one side first."""
    along = board[:, 1] - board[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    line = (board[:, :1] + t[None, :, None] * along[:, None])[:, None, None]
    off = np.array([[-1.0], [1.0]]) * np.linspace(_NEAR_MM, _FAR_MM, _DEPTHS)
    points = line + off[None, :, :, None, None] * normal[:, None, None, None]
    return np.asarray(points.reshape(len(board), -1, 2))

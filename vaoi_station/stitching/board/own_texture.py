"""Separate the texture of the board from that of its surroundings: a carrier, or a dirty or textured belt.

Texture beside the board may move with it, stand still, or lie at another height, so that its links contradict those of
the board. The outline in the CAD data decides which links lie on the board. This is valid only where the pictures
confirm the outline: each side of it that is in view must show an edge where C puts this side, and no stronger edge near
by, but for those of components.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Observations
from vaoi_station.stitching.adjustment.problem import Problem
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.orientation import outline_polygons, straight_pieces, subsample_pieces
from vaoi_station.stitching.board.outline import edge_profiles
from vaoi_station.stitching.matching.scene import Scene

MOST_BESIDE = 0.03
"""Largest share of links beside the board that need not be left out: the robust loss copes with them."""
_MOST_AT_EDGE = 0.1
"""Largest share of links outside the outline in one pair of frames that need not be left out."""
_MARGIN_MM = 1.0
"""Links outside the outline by more than this lie beside the board; errors of C and of cutting are smaller."""
HALF_PATCH_PX = 12.0
"""Links on the board that are nearer to the outline than this measure a mixture of board and surroundings."""
_EDGE_NEAR_MM = 0.5
"""Largest distance between a side's edge in the pictures and its position by C, due to cutting and fiducials."""
_QUANTILE = 0.25
"""The step of grey level of a side is this quantile of the steps of its pieces.

The edge of a board runs along all pieces of a side; a row of pads runs along only some of them. Where components hide
more than the other pieces, nothing is known of a line."""
_LEAST_EDGE = 4.0
"""Smallest step of grey level at the edge of a side."""
_STANDS_OUT = 1.15
"""A side of the outline stands out only if its step at the edge exceeds other steps by this factor.

The other steps are those more than twice `_EDGE_NEAR_MM` away from the expected edge."""
_PART_MM = 0.35
"""Distance from a component, with solder and silkscreen, up to which a step of grey level contains its edge.

A connector along a side shows a stronger edge than the board, which is no reason to doubt the outline."""
_LEAST_PIECES = 2
"""Least number of pieces of a side in view; with fewer, the side is not checked."""


class LeftOut(NamedTuple):
    """The links that were left out because they lie beside the board."""

    share: float
    """Share of these links in all links between rows."""
    confirmed: bool
    """Whether the pictures show the edges of the board at its outline."""
    links: Observations
    """These links."""


def beside(plane: BoardPlane, c: Floats, board_mm: Floats, margin_mm: float = _MARGIN_MM) -> NDArray[np.bool_]:
    """Return which board points (k, 2), mm, lie outside the outline by more than a margin; none without an outline.

    With a negative margin, points inside the outline and nearer to it than the margin count as outside too.
    """
    return beside_in_cad(plane.board_type, apply(np.linalg.inv(plane.matrix(c)), board_mm), margin_mm)


def beside_in_cad(board_type: BoardType, cad: Floats, margin_mm: float) -> NDArray[np.bool_]:
    """Return the same as `beside` for points (k, 2) in CAD coordinates."""
    polygons = outline_polygons(board_type)
    # A board type with fixture marks describes its carrier: links there are meant to be used.
    if not polygons or board_type.fixture_marks:
        return np.zeros(len(cad), np.bool_)
    ends = polygons[0]
    inside, near = np.zeros(len(cad), np.bool_), np.full(len(cad), np.inf)
    x, y = cad.T
    for (ax, ay), (bx, by) in zip(ends, np.roll(ends, -1, 0), strict=True):
        way = np.array([bx - ax, by - ay])
        crosses = (ay > y) != (by > y)
        # A ray to the right crosses the outline of a simple polygon an odd number of times from inside.
        inside ^= crosses & (x < ax + (y - ay) * way[0] / (way[1] if way[1] else np.inf))
        along = np.clip(((x - ax) * way[0] + (y - ay) * way[1]) / max(float(way @ way), 1e-12), 0, 1)
        near = np.minimum(near, np.hypot(x - ax - along * way[0], y - ay - along * way[1]))
    depth = np.where(inside, near, -near) * board_type.mm_per_unit
    return np.asarray(depth < -margin_mm)


def shares_beside(plane: BoardPlane, c: Floats, links: Observations, motion: Motion) -> tuple[float, float]:
    """Return the share of the links between rows that lie beside the board, and that of the links between cameras."""
    off, between = beside(plane, c, motion.board(links.p, links.a_mm)), links.p == links.q
    rows, seams = off[~between], off[between]
    return (float(rows.mean()) if len(rows) else 0.0), (float(seams.mean()) if len(seams) else 0.0)


def links_on_board(
    plane: BoardPlane, c: Floats, links: Observations, motion: Motion, px_per_mm: float
) -> NDArray[np.int_]:
    """Return the indices of the links whose patches lie wholly on the board."""
    return np.flatnonzero(~beside(plane, c, motion.board(links.p, links.a_mm), -HALF_PATCH_PX / px_per_mm))


def without_links_beside(
    plane: BoardPlane, problem: Problem, motion: Motion, c: Floats, confirmed: Callable[[], bool]
) -> Problem:
    """Return a problem without those links beside a board at position `c` that may be left out in any case.

    Carrier, belt or bed lie at another height than the board. Links between cameras there would bend its estimated
    surface, or show a displaced camera (seed 100346). They say nothing about the motion of the rows, so that they need
    not be confirmed by an edge. Between rows, links outside the outline are left out if they are more than
    `_MOST_AT_EDGE` of a pair of frames, and if the pictures confirm the outline (`confirmed`): along the edge of the
    board, patches are found where the texture of a bed is (seed 102577: nine of them outvoted two on a component).
    """
    links = problem.links
    off = beside(plane, c, motion.board(links.p, links.a_mm), 0.0)
    share = np.bincount(links.group, off) / np.maximum(np.bincount(links.group), 1)
    between = links.p == links.q
    at_edge = off & ~between & (share[links.group] > _MOST_AT_EDGE)
    # The outline is checked only where it matters: that takes longer than all else here.
    off &= between | (at_edge if at_edge.any() and confirmed() else between)
    return problem.select(np.flatnonzero(~off)) if off.any() else problem


def outline_confirmed(plane: BoardPlane, cad_matrix: Floats, scene: Scene, motion: Motion) -> bool:
    """Return whether every side of the outline that is in view shows its edge where C (`cad_matrix`) puts it."""
    pieces = straight_pieces(outline_polygons(plane.board_type), plane.board_type.mm_per_unit)
    if not len(pieces):
        return False
    board = apply(cad_matrix, pieces[subsample_pieces(len(pieces))])
    step_mm, normal, steps = edge_profiles(board, scene, motion)
    offset = (np.arange(steps.shape[1]) - steps.shape[1] // 2) * step_mm
    at_edge, seen = np.abs(offset) <= _EDGE_NEAR_MM, (steps > 0).mean(1) > 0.5
    others = other_steps(plane, cad_matrix, board, normal[:, None] * offset[:, None], steps, 2 * _EDGE_NEAR_MM)
    side = np.rint(np.arctan2(normal[:, 1], normal[:, 0]) / (np.pi / 4)).astype(int) % 8
    sides = 0
    for one in np.unique(side[seen]).tolist():
        mine = np.flatnonzero(seen & (side == one))
        if len(mine) < _LEAST_PIECES:
            continue
        if strongest_line(steps[mine][:, at_edge]) < max(_LEAST_EDGE, _STANDS_OUT * strongest_line(others[mine])):
            return False
        sides += 1
    return sides > 0


def other_steps(
    plane: BoardPlane, cad_matrix: Floats, board_mm: Floats, offset_mm: Floats, steps: Floats, beyond_mm: float
) -> Floats:
    """Return the steps across pieces of the outline without those at its edge and at the edges of components, as NaN.

    Args:
        plane: plane of the board type.
        cad_matrix: C, (3, 3).
        board_mm: (k, 2, 2) start and end of the pieces, tester coordinates.
        offset_mm: (k, samples, 2) displacements at which the steps were measured.
        steps: (k, samples) the steps of grey level.
        beyond_mm: steps up to this distance from a piece belong to its edge.
    """
    away = np.hypot(offset_mm[..., 0], offset_mm[..., 1]) > beyond_mm
    return np.where(away & ~_shows_part(plane, cad_matrix, board_mm, offset_mm), steps, np.nan)


def strongest_line(steps: Floats) -> float:
    """Return the strongest step of a line along pieces of a side, from their steps (k, samples); NaN is unknown.

    Between components that hide most of a line, a single pad or marking would count as a line: such lines are left out.
    """
    shown = np.isfinite(steps).mean(0) >= _QUANTILE
    return float(_quantile_of_known(steps[:, shown]).max(initial=0.0))


def _quantile_of_known(values: Floats) -> Floats:
    """Return the `_QUANTILE` of every column (n,) of values (k, n) without those that are NaN; each has one at least.

    `numpy.nanquantile` gives the same, but takes more than a hundred times as long.
    """
    if not values.size:
        return np.zeros(values.shape[1])
    at = _QUANTILE * (np.isfinite(values).sum(0) - 1)
    # NaN is sorted behind all numbers.
    ascending, low, column = np.sort(values, axis=0), np.floor(at).astype(np.int_), np.arange(values.shape[1])
    below, above = ascending[low, column], ascending[np.ceil(at).astype(np.int_), column]
    return np.asarray(below + (at - low) * (above - below))


def _shows_part(plane: BoardPlane, cad_matrix: Floats, board_mm: Floats, offset_mm: Floats) -> NDArray[np.bool_]:
    """Return whether pieces of the outline (k, 2, 2), displaced by (k, samples, 2), reach a component, (k, samples)."""
    along = np.stack([board_mm[:, 0], board_mm.mean(1), board_mm[:, 1]], 1)
    points = along[:, :, None] + offset_mm[:, None]
    cad_from_board = np.asarray(np.linalg.inv(cad_matrix), np.float64)
    found = plane.components.widened(_PART_MM).find(cad_from_board, points.reshape(-1, 2))
    return np.asarray((found >= 0).reshape(points.shape[:3]).any(1))

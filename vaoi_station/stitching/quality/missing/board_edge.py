"""Frames that show the end of the board where the motion puts it, although they show hardly anything else of the board.

A frame at the end of a run may show a strip of the board without a corner that is found again. Corners on a bed beside
the board prove nothing, since a bed looks the same at any time. But the edge of the board that lies across the motion
is elsewhere in a picture of any other moment.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.orientation import outline_polygons, straight_pieces
from vaoi_station.stitching.board.outline import edge_profiles
from vaoi_station.stitching.board.own_texture import other_steps, strongest_line
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.scene import Scene

_NEAR_MM = 0.15
"""Largest distance of the edge from its place by C. Rows are millimetres apart, boards are cut to 0.1 or 0.2 mm."""
_BEYOND_MM = 0.6
"""Distance from the edge at which its step has ended: steps are differences over 0.7 mm."""
_LEAST_EDGE, _STANDS_OUT = 8.0, 3.0
"""Least step of grey level at the edge, and least ratio to all other steps within 3.5 mm.

In seven sound frames of the hostile suite that nothing else confirms, the edge has 24 to 52 grey levels, 6.5 to 7.2
times as many as the next line. Of 714 frames that nothing else confirms, in drawings with frames of another moment, 80
are confirmed, and all of these are of their moment (docs/measured/uncertainty.md)."""
_ACROSS = 0.9
"""Least cosine of the angle between the outward normal of a piece and the motion."""
_LEAST_PIECES = 2
"""Least number of pieces of one end of the board that must be in view."""


def frames_with_edge(
    frames: Iterable[FrameKey],
    plane: BoardPlane,
    cad_matrix: Floats,
    scene: Scene,
    motion: Motion,
    velocity_mm_s: Floats,
) -> frozenset[FrameKey]:
    """Return those of the frames that show an end of the board where C and the motion put it; none without an outline.

    Args:
        frames: camera and row of the frames to examine.
        plane: plane of the board type.
        cad_matrix: C, (3, 3).
        scene: the cameras and the good frames.
        motion: motion of the board.
        velocity_mm_s: (2,) nominal velocity of the belt, of which the direction is used.
    """
    pieces = straight_pieces(outline_polygons(plane.board_type), plane.board_type.mm_per_unit)
    # A board type with fixture marks describes its carrier, whose edge nothing is known of.
    if not len(pieces) or plane.board_type.fixture_marks:
        return frozenset()
    board, way = apply(cad_matrix, pieces), velocity_mm_s / np.hypot(*velocity_mm_s)
    there = set(scene.present)

    def shows_end(key: FrameKey, picture: FrameKey) -> bool:
        alone = replace(scene, present=(key,), prepared=lambda _: scene.prepared(picture))
        return _shows_end(plane, cad_matrix, board, alone, motion, way)

    def is_repeated(key: FrameKey) -> bool:
        # A picture of the moment before shows what it shows in the same pixels. On a carrier, another edge than the
        # board's may then lie where that is expected (seed 104256).
        before = (key[0], key[1] - 1)
        return before in there and shows_end(key, before)

    return frozenset(key for key in frames if shows_end(key, key) and not is_repeated(key))


def _shows_end(plane: BoardPlane, cad_matrix: Floats, board: Floats, scene: Scene, motion: Motion, way: Floats) -> bool:
    """Return whether the single frame of a scene shows one of the board's two ends in its place.

    `board` (k, 2, 2) are the pieces of the outline in tester coordinates, `way` (2,) is the direction of the motion.
    """
    step_mm, normal, steps = edge_profiles(board, scene, motion)
    offset = (np.arange(steps.shape[1]) - steps.shape[1] // 2) * step_mm
    known, at_edge, along = steps > 0, np.abs(offset) <= _NEAR_MM + step_mm / 2, normal @ way
    in_view = (np.abs(along) >= _ACROSS) & known[:, at_edge].all(1)
    for end in (along > 0, along < 0):
        mine = np.flatnonzero(in_view & end)
        if len(mine) < _LEAST_PIECES:
            continue
        seen = np.where(known, steps, np.nan)[mine]
        others = other_steps(plane, cad_matrix, board[mine], normal[mine, None] * offset[:, None], seen, _BEYOND_MM)
        edge, around = strongest_line(seen[:, at_edge]), strongest_line(seen[:, np.abs(offset) <= _BEYOND_MM])
        if edge >= max(_LEAST_EDGE, _STANDS_OUT * strongest_line(others), around):
            return True
    return False

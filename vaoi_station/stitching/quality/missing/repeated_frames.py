"""Frames that show the moment of the frame before: a camera or driver sent it twice, with noise of its own.

Links to the frame before and after such a frame fit where a board has equal parts at equal distances. If only few links
of a frame fit, its pixels decide: a board that has moved shows its texture elsewhere, a repeated one in the same place.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.orientation import outline_polygons
from vaoi_station.stitching.board.own_texture import HALF_PATCH_PX, beside
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.link import choose_corners
from vaoi_station.stitching.matching.patches import patch_centres
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.matching.static_texture import STATIC_PX, shows_patches

_LEAST_MOVED_PX = 4 * STATIC_PX
"""Least motion of the board that two frames must show; a board at rest looks the same twice."""
_LEAST_SAME = 5
"""Least number of corners on the board that must appear in the same place in a repeated frame."""
_MOST_MOVED = 0.5
"""Largest number of corners that appear where the motion puts them, per corner in the same place.

A smear on the lens and a light spot stay in their place too, but then the board shows corners that moved."""


def repeated_frames(
    frames: Iterable[FrameKey], plane: BoardPlane, c: Floats, scene: Scene, motion: Motion
) -> frozenset[FrameKey]:
    """Return those of the frames that show the board where the frame before shows it; none without an outline.

    Args:
        frames: camera and row of the frames to examine.
        plane: the CAD plane of the board.
        c: parameters of C (a, b, x, y).
        scene: the cameras and the good frames.
        motion: motion of the board.
    """
    # Without an outline, a bed that stands still beside the board would count as the board.
    if not outline_polygons(plane.board_type) or plane.board_type.fixture_marks:
        return frozenset()
    there = set(scene.present)
    return frozenset(
        (camera, row)
        for camera, row in frames
        if (camera, row - 1) in there and _repeated(camera, row, plane, c, scene, motion)
    )


def _repeated(camera: int, row: int, plane: BoardPlane, c: Floats, scene: Scene, motion: Motion) -> bool:
    lens, before = scene.cameras[camera], scene.prepared((camera, row - 1))
    height, width = before.grey.shape
    px = patch_centres(choose_corners(before, (0, 0, width, height)))
    if not len(px):
        return False
    board_mm = motion.board(np.full(len(px), row - 1), lens.ground(px))
    on_board = ~beside(plane, c, board_mm, -HALF_PATCH_PX / lens.px_per_mm)
    px, now_px = px[on_board], _seen_in(lens, row, board_mm[on_board], motion)
    if len(px) < _LEAST_SAME or np.hypot(*(now_px - px).T).min() < _LEAST_MOVED_PX:
        return False
    grey, now = before.grey, scene.prepared((camera, row)).grey
    same = int(shows_patches(grey, now, px, px, STATIC_PX)[0].sum())
    if same < _LEAST_SAME:
        return False
    return int(shows_patches(grey, now, px, now_px, STATIC_PX)[0].sum()) < _MOST_MOVED * same


def _seen_in(camera: Camera, row: int, board_mm: Floats, motion: Motion) -> Floats:
    """Return the pixels (k, 2) at which a camera shows points (k, 2) of the board, mm, in a row."""
    return camera.project(apply(motion.rows_from_tester[row], board_mm))

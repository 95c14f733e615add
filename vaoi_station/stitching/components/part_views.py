"""Pictures of components: the frame that shows each of them most central, its extent there, and the patch around it."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.footprints import FootprintViews
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.scene import Scene

_MOST = 32
"""Largest number of components of which a view is returned."""


class PartView(NamedTuple):
    """The most central view of a component."""

    part: int
    """Number of the component."""
    frame: FrameKey
    px: Floats
    """(2,) the component's centre, raw pixels."""
    half_px: Floats
    """(2,) half the extent of its footprint along the image's axes."""


def central_views(
    plane: BoardPlane, cad_matrix: Floats, scene: Scene, motion: Motion, views: FootprintViews
) -> list[PartView]:
    """Return one view for each of up to `_MOST` components, frame by frame: the view nearest to the frame's centre.

    Args:
        plane: plane of the board type.
        cad_matrix: C, (3, 3) from CAD to tester coordinates.
        scene: the cameras and frames.
        motion: motion of the rows.
        views: views of the components' centres.
    """
    if not plane.components.addresses:
        # The views of a board type without components are those of two of its corners.
        return []
    best = _nearest_to_centre(scene, views)
    half_mm = np.ptp(apply(cad_matrix, plane.components.corners[views.point[best]]), axis=1) / 2
    found = []
    # frame by frame, so that each frame is fetched only once
    for n in np.lexsort((views.row[best], views.camera[best])).tolist():
        view = best[n]
        i, j, px = int(views.camera[view]), int(views.row[view]), views.px[view]
        camera = scene.cameras[i]
        # A footprint's extent in the picture: camera and board may be turned by quarters against one another.
        across = camera.ground(np.array([px, px + (1, 0)]))
        way = np.abs(motion.turned(np.array([j]), np.diff(across, axis=0))[0])
        half = half_mm[n] if way[0] >= way[1] else half_mm[n][::-1]
        found.append(PartView(int(views.point[view]), (i, j), px, half * camera.px_per_mm))
    return found


def _nearest_to_centre(scene: Scene, views: FootprintViews) -> Ints:
    """Return the indices of one view for each of up to `_MOST` components: the view nearest to the frame's centre."""
    present = np.zeros((len(scene.cameras), int(views.row.max(initial=0)) + 1), np.bool_)
    for i, j in scene.present:
        if j < present.shape[1]:
            present[i, j] = True
    use = np.flatnonzero(present[views.camera, views.row])
    centre = np.array([camera.center_px for camera in scene.cameras])[views.camera[use]]
    order = use[np.lexsort((np.hypot(*(views.px[use] - centre).T), views.point[use]))]
    each = order[np.flatnonzero(np.diff(views.point[order], prepend=-1))]
    return np.asarray(each[np.unique(np.linspace(0, len(each) - 1, min(len(each), _MOST)).round().astype(np.int_))])


def reduced_patch(
    grey: NDArray[np.uint8], px: Floats, nodes: NDArray[np.int_], factor: int
) -> NDArray[np.float32] | None:
    """Return the patch of 2·`nodes` + 1 nodes per axis about the pixel nearest to `px`; None if it is not in view.

    Each node is the mean of `factor` × `factor` pixels.
    """
    (x, y), (far_x, far_y) = np.rint(px).astype(int), factor * nodes + factor // 2
    if min(x - far_x, y - far_y) < 0 or x + far_x >= grey.shape[1] or y + far_y >= grey.shape[0]:
        return None
    patch = grey[y - far_y : y + far_y + 1, x - far_x : x + far_x + 1].astype(np.float32)
    size = (2 * int(nodes[0]) + 1, 2 * int(nodes[1]) + 1)
    return np.asarray(cv2.resize(patch, size, interpolation=cv2.INTER_AREA) if factor > 1 else patch, np.float32)


def reduction(half_px: Floats, most_nodes: int) -> int:
    """Return the factor by which a patch is reduced to `most_nodes` nodes on each side of its middle, or one more.

    An odd factor keeps the middle of the patch in the middle of a pixel.
    """
    return 2 * math.ceil((float(half_px.max()) / most_nodes - 1) / 2) + 1

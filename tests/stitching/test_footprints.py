"""Components under points, and views of footprints, against the camera model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Euclidean, System
from vaoi_station.model import BoardType, Surface
from vaoi_station.stitching.board.board_plane import board_plane
from vaoi_station.stitching.geometry import ComponentIndex

C = np.array([1.0, 0.02, -12.0, -8.0])


def board(parts: list[dict[str, Any]], **keys: Any) -> BoardType:
    return BoardType.model_validate({"name": "b", "outline": [[0, 0], [30, 20]], "components": parts} | keys)


def part(ref: str, x: float, y: float, w: float, h: float, **keys: Any) -> dict[str, Any]:
    return {"ref": ref, "center": [x, y], "width": w, "height": h} | keys


@pytest.mark.parametrize("lift", [None, 1.0])
def test_views_are_where_the_camera_sees_the_footprint(workshop: Any, lift: float | None) -> None:
    kind = board([part("A", 8, 10, 6, 3), part("B", 22, 10, 4, 4), part("FAR", 29, 19, 1, 1)], y_axis="down")
    cameras = [workshop.camera((x, 0.0), distance_mm=100.0) for x in (-5, 9)]
    motion = [Euclidean.motion(0.001 * j, (0, 4.0 * j), System.ROW, System.TESTER) for j in range(3)]
    matrix = board_plane(kind, cameras[0]).matrix(C)
    surface = None if lift is None else Surface(lift_mm=lift)
    parts = ComponentIndex.of(kind)
    rows = np.array([d.matrix for d in motion])
    seen = FrameIndex(cameras, rows, surface=surface, tester_from_cad=matrix).views(parts.center)
    views = seen.by_address(parts.addresses)
    assert list(views) == ["A", "B", "FAR"]
    for component in kind.components:
        place = matrix @ (*component.center, 1)
        given = {(i, j): (x, y) for i, j, x, y in views[component.address]}
        for i, camera in enumerate(cameras):
            for j, d in enumerate(motion):
                px = camera.project(d(place[:2]), lift or 0.0)
                if (i, j) in given:
                    assert given[i, j] == pytest.approx(px, abs=1e-4)
                else:
                    assert not camera.sees(px)

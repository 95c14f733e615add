"""The orientation from painted pictures of a board, as placed and turned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.board.outline import (
    compare_orientations,
    measure_outline_contrast,
)
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

OUTLINE = [[0.0, 0.0], [34.0, 22.0]]
PARTS: list[dict[str, Any]] = [
    {"ref": f"U{k}", "center": [x, y], "width": w, "height": h}
    for k, (x, y, w, h) in enumerate([(8, 6, 8, 5), (24, 8, 5, 8), (12, 16, 6, 4), (27, 16, 7, 5)])
]
PLACED = np.array([[1.0, 0, -16.0], [0, 1, -10.0], [0, 0, 1]])
TURNED = np.array([[-1.0, 0, 13.0], [0, -1, 9.0], [0, 0, 1]])
"""About the middle of the fiducials, which is not the middle of the board."""
STILL = nominal_motion(np.array([0.0]), np.zeros(2), np.zeros(2))


def board(**keys: Any) -> BoardType:
    return BoardType.model_validate({"name": "b", "y_axis": "down", **keys})


def scene(workshop: Any, paint: list[tuple[list[list[float]], float]], belt: float = 20.0) -> Scene:
    """One frame of all of a board at rest, painted from rectangles in CAD coordinates."""
    camera = workshop.camera((0.0, 0.0), size_px=(440, 320))
    y, x = np.mgrid[:320, :440].astype(float)
    cad = apply(np.linalg.inv(PLACED), camera.ground(np.stack([x, y], -1).reshape(-1, 2))).reshape(320, 440, 2)
    picture = np.full((320, 440), belt)
    for corners, grey in paint:
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        picture[((cad >= low) & (cad <= high)).all(-1)] = grey
    picture += np.random.default_rng(0).normal(0, 2, picture.shape)
    frame = PreparedFrame(workshop.digitised(picture))
    return Scene((camera,), ((0, 0),), lambda key: frame)


def footprints(grey: float) -> list[tuple[list[list[float]], float]]:
    out = []
    for part in PARTS:
        (x, y), w, h = part["center"], part["width"], part["height"]
        out.append(([[x - w / 2, y - h / 2], [x + w / 2, y + h / 2]], grey))
    return out


@pytest.mark.parametrize("grey", [80.0, 5.0])
def test_the_outline_decides_the_orientation(workshop: Any, grey: float) -> None:
    seen = scene(workshop, [(OUTLINE, grey)], belt=40.0)
    right = compare_orientations(board(outline=OUTLINE), PLACED, TURNED, seen, STILL)
    wrong = compare_orientations(board(outline=OUTLINE), TURNED, PLACED, seen, STILL)
    assert right is not None
    assert wrong is not None
    assert (right.evidence, right.confirms, right.contradicts) == ("outline", True, False)
    assert (wrong.confirms, wrong.contradicts) == (False, True)
    assert right.as_placed == pytest.approx(abs(grey - 40), abs=4)
    assert right.turned < 4


def test_components_decide_where_the_outline_does_not(workshop: Any) -> None:
    """Belt and board are equally bright."""
    seen = scene(workshop, [(OUTLINE, 60.0), *footprints(150.0)], belt=60.0)
    kind = board(outline=OUTLINE, components=PARTS)
    right = compare_orientations(kind, PLACED, TURNED, seen, STILL)
    assert right is not None
    assert (right.evidence, right.confirms) == ("components", True)
    wrong = compare_orientations(kind, TURNED, PLACED, seen, STILL)
    assert wrong is not None
    assert wrong.contradicts


def shifted(x_mm: float) -> NDArray[np.float64]:
    return np.asarray(np.array([[1.0, 0, x_mm], [0, 1, x_mm], [0, 0, 1]]) @ PLACED)


def test_the_outline_is_visible_where_it_is_and_nowhere_else(workshop: Any) -> None:
    seen = scene(workshop, [(OUTLINE, 80.0)])
    here = measure_outline_contrast(board(outline=OUTLINE), PLACED, seen, STILL)
    assert here is not None
    assert here.visible
    assert here.contrast == pytest.approx(60, abs=3)
    assert here.pieces >= 20
    off = measure_outline_contrast(board(outline=OUTLINE), shifted(1.5), seen, STILL)
    assert off is not None
    assert not off.visible

"""A drawn board in one frame: bodies, texture and marks at exactly known places, and C."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.board_check.correction import Group, Move, moved_board_type
from vaoi_station.board_check.overview import CheckedRun
from vaoi_station.geometry import Camera, Lens, Projective, System, apply
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.stitching.geometry import ComponentIndex

PX_PER_MM = 14.0
SIZE = (840, 640)
MIDDLE = (25.0, 18.0)
ALL: tuple[Group, ...] = ("components", "fiducials", "outline")


def drawn_board(seed: int = 1, count: int = 40) -> BoardType:
    """A board of 50 × 36 mm, y up, with chips and packages that do not touch."""
    random, parts = np.random.default_rng(seed), list[dict[str, Any]]()
    places = np.zeros((0, 2))
    while len(parts) < count:
        at = np.round(random.uniform((4, 4), (46, 32)), 3)
        if len(places) and np.hypot(*(places - at).T).min() < 3.4:
            continue
        places = np.vstack([places, at])
        size = ((2.0, 1.2), (1.0, 0.6), (2.4, 2.4), (3.2, 1.6))[int(random.integers(4))]
        rotation = float(random.integers(4)) * 90
        parts.append(
            {
                "ref": f"U{len(parts) + 1}",
                "center": at.tolist(),
                "width": size[0],
                "height": size[1],
                "rotation": rotation,
                "body_height": 0.5,
            }
        )
    marks = [{"name": f"F{n}", "x": x, "y": y, "diameter": 1} for n, (x, y) in enumerate([(2, 2), (48, 3), (47, 34)])]
    return BoardType.model_validate(
        {"name": "drawn", "outline": [[0, 0], [50, 36]], "fiducials": marks, "components": parts, "revision": "B"}
    )


def drawn_run(board: BoardType, own: BoardType | None = None) -> CheckedRun:
    """Draw a board into one frame; the run was stitched with `own`, by default the same board type."""
    image_from_row = np.array([[PX_PER_MM, 0, 60.0], [0, -PX_PER_MM, 580.0], [0, 0, 1]])
    camera = Camera(*SIZE, Projective(image_from_row, System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0), 400.0)
    a = np.radians(0.4)
    c = np.array([[np.cos(a), -np.sin(a), 1.2], [np.sin(a), np.cos(a), 0.7], [0, 0, 1.0]])
    random = np.random.default_rng(7)
    fine = 4
    canvas = np.full((SIZE[1] * fine, SIZE[0] * fine), 20, np.uint8)

    def fill(corners: NDArray[np.float64], grey: int) -> None:
        px = (apply(image_from_row @ c, corners) + 0.5) * fine - 0.5
        cv2.fillPoly(canvas, [np.rint(px * 16).astype(np.int32)], grey, cv2.LINE_8, 4)

    fill(np.array([(0, 0), (50, 0), (50, 36), (0, 36)], dtype=np.float64), 70)
    for _ in range(60):
        x, y = random.uniform((1, 1), (46, 35))
        fill(np.array([(x, y), (x + random.uniform(1, 5), y), (x + 0.3, y + 0.2), (x, y + 0.2)]), 85)
    for corners, size in zip(ComponentIndex.of(board).corners, ComponentIndex.of(board).size, strict=True):
        fill(corners, int(random.choice([30, 150])))
        middle = corners.mean(0)
        fill(middle + 0.5 * (corners - middle), 60 if size[0] == size[1] else 110)
    for f in board.fiducials:
        px = (apply(image_from_row @ c, np.array([f.x, f.y])) + 0.5) * fine - 0.5
        for radius, grey in ((1.1, 55), (0.5, 220)):
            at = (round(float(px[0]) * 16), round(float(px[1]) * 16))
            cv2.circle(canvas, at, round(radius * PX_PER_MM * fine * 16), grey, -1, cv2.LINE_8, 4)
    frame = cv2.resize(canvas, SIZE, interpolation=cv2.INTER_AREA).astype(np.float64)
    frame = np.clip(np.rint(frame + random.normal(0, 1.5, frame.shape)), 0, 255).astype(np.uint8)
    stitch = Stitch(
        method="auto",
        image_matrices=((image_from_row,),),
        cad_matrix=c,
        row_motion=(np.eye(3),),
        status=Status.OK,
    )
    return CheckedRun(stitch, (camera,), lambda _, __: frame, (), own or board)


def moved(board: BoardType, move: Move, groups: tuple[Group, ...] = ALL) -> BoardType:
    """The board type with wrong data; without an outline if the components leave it behind."""
    left = board if "outline" in groups else board.model_copy(update={"outline": None})
    return moved_board_type(left, move, groups).model_copy(update={"revision": "B", "state": None})


@pytest.fixture(scope="session")
def board() -> BoardType:
    return drawn_board()


@pytest.fixture(scope="session")
def run(board: BoardType) -> CheckedRun:
    return drawn_run(board)

"""Warm-up of the workers: a small synthetic board is stitched before they report that they are ready.

The warm-up loads libraries, and calls the functions that are compiled at their first call. So the first real frame
takes no longer than later frames. What the first pictures of a board need comes first (`warm_up`); what is measured
after them, in spare time, comes last (`warm_up_later`).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.hdr import Exposed, merge_views
from vaoi_station.heights.estimates import measure_heights
from vaoi_station.marks import find_candidates, locate_mark
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.mosaic import MosaicGrid, TakenFrame, TileRenderer, choose_frames, make_plan, render_tile
from vaoi_station.photometry import FieldMaps, NoiseModel, Taken
from vaoi_station.rendering import ViewCalculator, render_all
from vaoi_station.steps import completed
from vaoi_station.stitching.conclude import explained
from vaoi_station.stitching.matching.evidence import Evidence, Links, Task
from vaoi_station.stitching.matching.frames import resample
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

_PX_PER_MM, _WIDTH_PX, _HEIGHT_PX = 10.0, 400, 300
_CAMERAS, _ROWS, _PITCH_MM, _STEP_MM, _PERIOD_S = 2, 3, 36.0, 12.0, 0.1
_MARKS_MM, _MARK_MM = ((8.0, 5.0), (66.0, 8.0), (30.0, 24.0)), 1.5
_SIZE_MM = (_PITCH_MM * (_CAMERAS - 1) + _WIDTH_PX / _PX_PER_MM, _HEIGHT_PX / _PX_PER_MM)
_RESAMPLED_PX = 8
_BELT, _AROUND, _COPPER = 20, 40, 220
_SUBPIXEL_BITS = 4
_TIMES_S = np.arange(_ROWS, dtype=np.float64) * _PERIOD_S
_PRESENT = [(camera, row) for camera in range(_CAMERAS) for row in range(_ROWS)]
_INFORMATION = 400.0
"""Of an exact link, px⁻²: a standard deviation of 0.05 px."""


def warm_up() -> None:
    """Stitch the synthetic board and render its components: what the first pictures of a board need."""
    picture = _picture()
    setup = _setup()
    runner = TaskRunner(setup, partial(_frame, picture))
    links = [runner.perform(task) for task in _tasks(setup) if task.kind != "marks"]
    # Pictures before marks and adjustment, with which the second process begins.
    _render(setup, picture)
    _concluded(setup, picture, links)


def warm_up_from_the_end() -> None:
    """Call what `warm_up` calls, but begin with what it calls last, and do without the comparison of patches.

    A second process does this while the first one warms up: neither waits long for what the other one compiles.
    """
    setup, picture = _setup(), _picture()
    _concluded(setup, picture, _true_links(setup))
    _render(setup, picture)


def warm_up_later() -> None:
    """Call what only some stations need, and what is computed after the pictures of a board.

    The frames of cameras that differ and marks that are no discs come first: a board that needs them waits.
    """
    setup, picture = _setup(), _picture()
    resample(picture, np.eye(2, 3), (_RESAMPLED_PX, _RESAMPLED_PX), 1.0)
    _locate_mark(picture, "square")
    board_type, stitch = setup.board_type, _true_stitch(setup)
    assert board_type is not None, "the synthetic board has a board type"
    explained(*_concluded(setup, picture, _true_links(setup)))
    _plan(setup, board_type, stitch, picture)
    _merge(ViewCalculator(board_type, stitch, setup.cameras), board_type, picture)
    measure_heights(board_type, stitch, setup.cameras, partial(_frame, picture))


def _tasks(setup: StitchSetup) -> tuple[Task, ...]:
    return all_tasks(_PRESENT, dict(enumerate(_TIMES_S)), setup)


def _concluded(setup: StitchSetup, picture: NDArray[np.uint8], links: Iterable[Evidence]) -> tuple[Stitch, Findings]:
    """Locate marks, and conclude the synthetic board from them and links."""
    find_candidates(picture, "circle", _MARK_MM * _PX_PER_MM)
    _locate_mark(picture, "circle")
    runner = TaskRunner(setup, partial(_frame, picture))
    marks = [runner.perform(task) for task in _tasks(setup) if task.kind == "marks"]
    return runner.answer(_TIMES_S, _PRESENT, [*links, *marks])


def _true_links(setup: StitchSetup) -> list[Evidence]:
    """Return links on a grid of exact places."""
    grid_px = np.mgrid[10:_WIDTH_PX:20, 10:_HEIGHT_PX:20].reshape(2, -1).T.astype(np.float64)
    links: list[Evidence] = []
    for task in _tasks(setup):
        if task.kind == "marks" or task.b is None:
            continue
        cameras, rows = np.subtract(task.b, task.a)
        b_px = grid_px + np.array([-_PITCH_MM * cameras, _STEP_MM * rows]) * _PX_PER_MM
        shown = np.all((b_px > 0) & (b_px < (_WIDTH_PX - 1, _HEIGHT_PX - 1)), axis=1)
        count = int(shown.sum())
        information = np.tile(np.eye(2) * _INFORMATION, (count, 1, 1))
        links.append(Links(task, grid_px[shown], b_px[shown], information, np.ones(count), tried=count))
    return links


def _render(setup: StitchSetup, picture: NDArray[np.uint8]) -> None:
    board_type = setup.board_type
    assert board_type is not None, "the synthetic board has a board type"
    views = ViewCalculator(board_type, _true_stitch(setup), setup.cameras)
    render_all(views.compute_all(board_type.components), partial(_frame, picture))


def _true_stitch(setup: StitchSetup) -> Stitch:
    motion = [np.array([[1, 0, 0], [0, 1, _STEP_MM * row], [0, 0, 1.0]]) for row in range(_ROWS)]
    return Stitch(
        method="auto",
        image_matrices=tuple(tuple(c.image_from_row.matrix @ d for d in motion) for c in setup.cameras),
        cad_matrix=np.eye(3),
        row_motion=tuple(motion),
        status=Status.OK,
    )


def _locate_mark(picture: NDArray[np.uint8], shape: Literal["circle", "square"]) -> None:
    first_px = (np.array(_MARKS_MM[0]) + (0, _STEP_MM * (_ROWS - 1))) * _PX_PER_MM
    locate_mark(picture, first_px, shape, _MARK_MM * _PX_PER_MM)


def _plan(setup: StitchSetup, board_type: BoardType, stitch: Stitch, picture: NDArray[np.uint8]) -> None:
    taken = [TakenFrame(camera, row, 1.0) for camera in range(_CAMERAS) for row in range(_ROWS)]
    base, projector = MosaicGrid.of_board(board_type, _PX_PER_MM), FrameIndex.of_result(stitch, setup.cameras)
    plan = completed(
        make_plan(
            choose_frames(taken),
            partial(_frame, picture),
            projector=projector,
            board_type=board_type,
            stitch=stitch,
            base=base,
        )
    )
    render_tile(TileRenderer(plan, projector, base).spec((0, 0, base.width, base.height)), partial(_frame, picture))


def _merge(views: ViewCalculator, board_type: BoardType, picture: NDArray[np.uint8]) -> None:
    [shown, *_] = views.compute_all(board_type.components).values()
    maps = FieldMaps(np.ones((_HEIGHT_PX, _WIDTH_PX), np.float32), 2.0, NoiseModel())
    merge_views(
        [
            Exposed(v, Taken(100.0), maps, (_WIDTH_PX, _HEIGHT_PX), partial(_frame, picture, v.camera, v.row))
            for v in shown
        ]
    )


def _setup() -> StitchSetup:
    # The lens has distortion and the board type has all kinds of elements, so that all compiled functions are called.
    lens = Lens(((_WIDTH_PX - 1) / 2, (_HEIGHT_PX - 1) / 2), float(np.hypot(_WIDTH_PX, _HEIGHT_PX)) / 2, (-1e-4,))
    matrices = (
        np.array([[_PX_PER_MM, 0, -_PX_PER_MM * _PITCH_MM * i], [0, _PX_PER_MM, 0], [0, 0, 1]]) for i in range(_CAMERAS)
    )
    cameras = tuple(
        Camera(_WIDTH_PX, _HEIGHT_PX, Projective(n, System.IMAGE, System.ROW), lens, 300.0) for n in matrices
    )
    return StitchSetup(cameras, (0.0, _STEP_MM / _PERIOD_S), _PERIOD_S, _board_type())


def _board_type() -> BoardType:
    parts = [{"ref": f"U{n}", "center": (15 + 12 * n, 15), "width": 4, "height": 4} for n in range(4)]
    marks = [{"name": f"F{n}", "x": x, "y": y, "diameter": _MARK_MM} for n, (x, y) in enumerate(_MARKS_MM)]
    return BoardType.model_validate(
        {"name": "warm-up", "y_axis": "down", "outline": ((0, 0), _SIZE_MM), "fiducials": marks, "components": parts}
    )


def _picture() -> NDArray[np.uint8]:
    """Draw belt and board as one grey image (h, w), out of which `_frame` cuts the frames of all cameras and rows."""
    g = np.random.default_rng(0)
    height, width = (round(mm * _PX_PER_MM) for mm in (_SIZE_MM[1] + _STEP_MM * (_ROWS - 1), _SIZE_MM[0]))
    # Blurred noise has corners everywhere, so that every kind of link finds something to refine.
    noise = cv2.GaussianBlur(g.normal(0, 60, (height, width)), (0, 0), 1.5)
    image: NDArray[np.uint8] = np.clip(90 + noise, 0, 255).astype(np.uint8)
    image[: round(_STEP_MM * (_ROWS - 1) * _PX_PER_MM)] = _BELT
    for x, y in _MARKS_MM:
        at = np.array([x, y + _STEP_MM * (_ROWS - 1)]) * _PX_PER_MM
        middle = tuple(np.round(at * 2**_SUBPIXEL_BITS).astype(int).tolist())
        for diameter, grey in ((2.2 * _MARK_MM, _AROUND), (_MARK_MM, _COPPER)):
            radius = round(diameter / 2 * _PX_PER_MM * 2**_SUBPIXEL_BITS)
            cv2.circle(image, middle, radius, grey, cv2.FILLED, cv2.LINE_AA, _SUBPIXEL_BITS)
    return image


def _frame(picture: NDArray[np.uint8], camera: int, row: int) -> NDArray[np.uint8]:
    # The conveyor moves the board by `_STEP_MM` per row, so the cut-out moves up in the picture by this step.
    x, y = round(_PITCH_MM * camera * _PX_PER_MM), round(_STEP_MM * (_ROWS - 1 - row) * _PX_PER_MM)
    return np.ascontiguousarray(picture[y : y + _HEIGHT_PX, x : x + _WIDTH_PX])

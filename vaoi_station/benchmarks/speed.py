"""Measure the speed of stitching, rendering and mosaics in one thread; compare with the paper's method and bare warps.

Each figure is the median of several repetitions.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.benchmarks.boards import BenchmarkBoard, cpu_ms, one_thread
from vaoi_station.files.images import encode_jpeg
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry.robust import Failure
from vaoi_station.hdr import Exposed, merge_views
from vaoi_station.heights.estimates import measure_heights
from vaoi_station.model import Stitch
from vaoi_station.mosaic import MosaicGrid, TileRenderer, choose_frames, make_plan, render_tile
from vaoi_station.mosaic.frames import frames_of_head
from vaoi_station.mosaic.grid import TILE_PX, levels_of
from vaoi_station.photometry import FieldMaps, NoiseModel, Taken
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.rendering import View, ViewCalculator, render, render_all
from vaoi_station.steps import completed
from vaoi_station.stitching import paper_method as paper
from vaoi_station.stitching.matching.evidence import Evidence
from vaoi_station.stitching.work import TaskRunner, all_tasks


@dataclass(frozen=True)
class SpeedFigures:
    """Figures of the benchmark on one board. Times are CPU time of one thread unless a field states otherwise."""

    material: str
    cameras: int
    rows: int
    frame_px: tuple[int, int]
    repetitions: int
    stitch_ms_per_frame: float
    """Time to compute all matrices from the frames, including fiducials and C, per frame."""
    stitch_spread_ms: tuple[float, float]
    paper_ms_per_frame: float
    ratio_to_paper_method: float
    paper_failed: str
    ready_after_last_frame_ms: float
    """Wall time of the tasks of the last row and of matrices, C and verdict, when all earlier tasks are done."""
    images_per_s: float
    """Component images that are rendered per second, including the computation of their views."""
    render_ratio_to_warp: float
    """Time of `cv2.warpPerspective` alone, for the same images, divided by the time of our rendering."""
    hdr_ratio_to_plain: float
    """Time to merge the frames of every component to one radiance picture, divided by that of its plain images."""
    heights_ms: float | None
    """Time to measure the heights of all components; None if the calibration states no working distance."""
    status: str
    cad_sigma_px: float | None
    opencv: str


@one_thread()
def measure_stitching(board: BenchmarkBoard, repetitions: int = 5) -> SpeedFigures:
    """Measure stitching, the paper's method and rendering on one board."""
    # The first run also compiles functions, so it is not timed.
    stitch = stitch_board(board)
    frames = len(board.frames)
    ours = [cpu_ms(lambda: stitch_board(board)) / frames for _ in range(repetitions)]
    # Half the repetitions: the paper's method takes many times longer.
    theirs = [cpu_ms(lambda: _paper(board)) / frames for _ in range(max(repetitions // 2, 1))]
    outcome = _paper(board)
    ready = [_ready_ms(board) for _ in range(repetitions)]
    per_second, ratio = _rendering(board, stitch, repetitions)
    hdr = _hdr_ratio(board, stitch, repetitions)
    head = board.head
    return SpeedFigures(
        material=board.name,
        cameras=len(head.cameras),
        rows=head.rows,
        frame_px=(head.cameras[0].width, head.cameras[0].height),
        repetitions=repetitions,
        stitch_ms_per_frame=round(statistics.median(ours), 3),
        stitch_spread_ms=(round(min(ours), 3), round(max(ours), 3)),
        paper_ms_per_frame=round(statistics.median(theirs), 2),
        ratio_to_paper_method=round(statistics.median(theirs) / statistics.median(ours), 2),
        paper_failed=outcome.reason if isinstance(outcome, Failure) else "",
        ready_after_last_frame_ms=round(statistics.median(ready), 2),
        images_per_s=round(per_second, 1),
        render_ratio_to_warp=round(ratio, 3),
        hdr_ratio_to_plain=round(hdr, 2),
        heights_ms=_heights_ms(board, stitch, repetitions),
        status=stitch.status.value,
        cad_sigma_px=stitch.quality["cad_sigma_px"],
        opencv=cv2.__version__,
    )


def _heights_ms(board: BenchmarkBoard, stitch: Stitch, repetitions: int) -> float | None:
    setup = board.setup
    known = any(camera.working_distance_mm is not None for camera in setup.cameras)
    if setup.board_type is None or stitch.cad_matrix is None or not known:
        return None
    board_type = setup.board_type
    lights = tuple(setup.light(row) for row in range(board.head.rows)) if setup.lights else ()

    def measure() -> Any:
        return measure_heights(board_type, stitch, setup.cameras, board.frame, lights)

    measure()  # compiles
    return round(statistics.median(cpu_ms(measure) for _ in range(repetitions)), 1)


def stitch_board(board: BenchmarkBoard) -> Stitch:
    """Stitch a board, task by task, in this thread."""
    times_s = board.head.row_times_s()
    runner = TaskRunner(board.setup, board.frame)
    present = sorted(board.frames, key=lambda key: (key[1], key[0]))
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), board.setup)]
    return runner.conclude(times_s, present, evidence)


def _paper(board: BenchmarkBoard) -> Any:
    def grey(camera: int, row: int) -> NDArray[np.uint8]:
        return eight_bit_grey(board.frames[camera, row])

    return paper.chain_rows(board.setup.cameras, board.head.rows, grey)


def _ready_ms(board: BenchmarkBoard) -> float:
    """Return the wall time, ms, from the last frame to matrices and verdict, if all other tasks were done before."""
    times_s = board.head.row_times_s()
    runner = TaskRunner(board.setup, board.frame)
    present = list(board.frames)
    last = max(row for _, row in present)
    tasks = all_tasks(present, dict(enumerate(times_s)), board.setup)
    late = [t for t in tasks if last in {t.a[1], (t.b or t.a)[1]}]
    evidence: list[Evidence] = []
    for task in (t for t in tasks if t not in set(late)):
        evidence.append(runner.perform(task))
        runner.add_evidence(evidence[-1])
        prepare(runner)
    start = time.perf_counter()
    evidence += [runner.perform(t) for t in late]
    runner.answer(times_s, present, evidence)
    return (time.perf_counter() - start) * 1e3


def prepare(runner: TaskRunner) -> None:
    """Do what a worker does of the conclusion while the board passes."""
    while runner.prepare():
        pass


def _rendering(board: BenchmarkBoard, stitch: Stitch, repetitions: int) -> tuple[float, float]:
    """Return component images per second, and the time of `cv2.warpPerspective` alone divided by our time."""
    cameras = board.setup.cameras
    if stitch.cad_matrix is None:
        return 0.0, 0.0

    def ours() -> int:
        views = ViewCalculator(board.board_type, stitch, cameras).compute_all(board.board_type.components)
        return len(render_all(views, board.frame))

    views = ViewCalculator(board.board_type, stitch, cameras).compute_all(board.board_type.components)
    # Collected beforehand: only the warps are timed.
    warps = [
        (board.frames[v.camera, v.row], v.matrix, (v.width, v.height)) for v in chain.from_iterable(views.values())
    ]

    def bare() -> None:
        _warp(warps)

    count = ours()
    bare()
    # Both sides are measured alternately, so that a change of the CPU's clock rate affects both.
    pairs = [(cpu_ms(ours), cpu_ms(bare)) for _ in range(repetitions)]
    ours_ms = statistics.median(a for a, _ in pairs)
    return count / ours_ms * 1e3, statistics.median(b / a for a, b in pairs)


def _warp(warps: Iterable[tuple[NDArray[Any], Any, tuple[int, int]]]) -> None:
    for frame, matrix, size in warps:
        cv2.warpPerspective(frame, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def _hdr_ratio(board: BenchmarkBoard, stitch: Stitch, repetitions: int) -> float:
    """Return the time of merging the frames of all components, divided by that of rendering the same frames."""
    cameras, head = board.setup.cameras, board.head
    if stitch.cad_matrix is None:
        return 0.0
    calculator = ViewCalculator(board.board_type, stitch, cameras)
    views = [v for v in calculator.compute_all(board.board_type.components).values() if v]
    # A flat field like that of a lens, because merging divides by it pixel by pixel.
    flats = [np.full((c.height_px, c.width_px), 1.0, np.float32) for c in cameras]
    maps = [FieldMaps(flat, 2.0, NoiseModel()) for flat in flats]
    sizes = [(c.width_px, c.height_px) for c in cameras]

    def plain() -> None:
        for view in chain.from_iterable(views):
            render(view, board.frames[view.camera, view.row])

    def exposed(view: View) -> Exposed:
        key = view.camera, view.row
        return Exposed(
            view, Taken(head.exposure_us(*key)), maps[view.camera], sizes[view.camera], lambda: board.frames[key]
        )

    def merged() -> None:
        for part in views:
            merge_views([exposed(view) for view in part], groups=False, sigma=False)

    plain()
    merged()
    return statistics.median(cpu_ms(merged) / cpu_ms(plain) for _ in range(repetitions))


@dataclass(frozen=True)
class MosaicFigures:
    """Figures of the mosaic of one board. Times are CPU time of one thread."""

    material: str
    megapixels: float
    repetitions: int
    plan_ms: float
    mosaic_mpx_per_s: float
    """Rate at which the largest picture is rendered, without the plan and without writing."""
    mosaic_ratio_to_warp: float
    """Time of `cv2.warpPerspective` alone for the same pixels, divided by the time of the mosaic."""
    tile_ms_p50: float
    """Time for one tile of any level, rendered and encoded as JPEG: median."""
    tile_ms_p95: float


@one_thread()
def measure_mosaic(board: BenchmarkBoard, repetitions: int = 5) -> MosaicFigures:
    """Stitch a board and measure its mosaic; raise StateError if the board has no CAD mapping."""
    found = stitch_board(board)
    projector = FrameIndex.of_result(found, board.setup.cameras)
    grid = MosaicGrid.of_board(board.board_type, projector.px_per_mm)
    choice = choose_frames(frames_of_head(board.head, sorted(board.frames)))

    def planned() -> Any:
        options: dict[str, Any] = {"projector": projector, "board_type": board.board_type, "stitch": found}
        return completed(make_plan(choice, board.frame, base=grid, **options))

    plan = planned()
    renderer = TileRenderer(plan, projector, grid)
    boxes = _boxes(grid)
    warps = []
    for box in boxes:
        spec = renderer.spec(box)
        # The frame that shows most of the tile: all warps of a tile cost the same.
        part = max(spec.parts, key=lambda p: p.factor.size if p.mine is None else int(p.mine.sum()), default=None)
        if part is not None:
            warps.append((board.frames[part.camera, part.row], part.raw_from_tile, (spec.width, spec.height)))

    def ours() -> None:
        for box in boxes:
            render_tile(renderer.spec(box), board.frame)

    def bare() -> None:
        _warp(warps)

    ours()
    bare()
    # Both are measured in turn, so that a change of the CPU's clock rate affects both.
    pairs = [(cpu_ms(ours), cpu_ms(bare)) for _ in range(repetitions)]
    tiles = []
    for level in range(levels_of(grid)):
        reduced = grid.reduced(2**level)
        small = TileRenderer(plan, projector, reduced)
        tiles += [cpu_ms(partial(_encoded, small, box, board.frame)) for box in _boxes(reduced)]
    megapixels = grid.width * grid.height / 1e6
    return MosaicFigures(
        material=board.name,
        megapixels=round(megapixels, 2),
        repetitions=repetitions,
        plan_ms=round(statistics.median(cpu_ms(planned) for _ in range(repetitions)), 1),
        mosaic_mpx_per_s=round(megapixels / statistics.median(a for a, _ in pairs) * 1e3, 1),
        mosaic_ratio_to_warp=round(statistics.median(b / a for a, b in pairs), 3),
        tile_ms_p50=round(float(np.percentile(tiles, 50)), 2),
        tile_ms_p95=round(float(np.percentile(tiles, 95)), 2),
    )


def _boxes(grid: MosaicGrid) -> list[tuple[int, int, int, int]]:
    return [
        (x, y, min(x + TILE_PX, grid.width), min(y + TILE_PX, grid.height))
        for y in range(0, grid.height, TILE_PX)
        for x in range(0, grid.width, TILE_PX)
    ]


def _encoded(renderer: TileRenderer, box: tuple[int, int, int, int], read: Callable[[int, int], Any]) -> None:
    picture = render_tile(renderer.spec(box), read)
    if picture is not None:
        encode_jpeg(picture)

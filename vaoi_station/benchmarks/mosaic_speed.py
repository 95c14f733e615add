"""Measure how fast mosaics are planned and rendered, beside bare warps of the same pixels, in one thread."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from vaoi_station.benchmarks.benchmark_board import BenchmarkBoard
from vaoi_station.benchmarks.stitch_speed import stitch_board
from vaoi_station.files.images import encode_jpeg
from vaoi_station.model import Stitch
from vaoi_station.mosaic import MosaicGrid, TileRenderer, choose_frames, make_plan, render_tile
from vaoi_station.mosaic.deep_zoom import TILE_PX, levels_of
from vaoi_station.mosaic.frames import frames_of_head
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.mosaic.tiles import Scratch
from vaoi_station.steps import completed

_WARP_PX = 1024
"""Largest width of a bare warp."""
_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


@dataclass(frozen=True)
class MosaicFigures:
    """Figures of the mosaic of one board. Times are CPU time of one thread."""

    material: str
    megapixels: float
    """Size of the largest picture."""
    repetitions: int
    plan_ms: float
    """Time for the plan, from all frames; once per run."""
    mosaic_mpx_per_s: float
    """Rate at which the largest picture is rendered, without the plan and without writing."""
    mosaic_ratio_to_warp: float
    """Time of `cv2.warpPerspective` alone for the same pixels, divided by the time of the mosaic."""
    tile_ms_p50: float
    """Time for one tile of any level, rendered and encoded as JPEG: median."""
    tile_ms_p95: float

    def document(self) -> dict[str, Any]:
        """Return the figures as a JSON object."""
        return asdict(self)


def measure_mosaic(board: BenchmarkBoard, repetitions: int = 5, stitch: Stitch | None = None) -> MosaicFigures:
    """Measure the mosaic of a board; without a result, the board is stitched first.

    Raises:
        StateError: the board has no CAD mapping.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return _measure(board, repetitions, stitch)
    finally:
        cv2.setNumThreads(threads)


def _measure(board: BenchmarkBoard, repetitions: int, stitch: Stitch | None) -> MosaicFigures:
    found = stitch_board(board) if stitch is None else stitch
    projector = FrameProjector(found, board.setup.cameras)
    grid = MosaicGrid.of_board(board.board_type, projector.px_per_mm)
    choice = choose_frames(frames_of_head(board.head, sorted(board.frames)))

    def read(camera: int, row: int) -> Any:
        return board.frames.get((camera, row))

    def planned() -> Any:
        return completed(
            make_plan(choice, read, projector=projector, board_type=board.board_type, stitch=found, base=grid)
        )

    plan = planned()
    renderer = TileRenderer(plan, projector, grid)
    boxes = _boxes(grid, renderer.block_px)
    warps = []
    # Wider parts lie beside the frame for the most part, where a warp has nothing to sample.
    for box in _boxes(grid, (min(renderer.block_px[0], _WARP_PX), TILE_PX)):
        spec = renderer.spec(box)
        # The frame that shows most of the tile: all warps of a tile cost the same.
        part = max(spec.parts, key=lambda p: p.factor.size if p.mine is None else int(p.mine.sum()), default=None)
        if part is not None:
            warps.append((board.frames[part.camera, part.row], part.raw_from_tile, (spec.width, spec.height)))

    scratch = Scratch()

    def ours() -> None:
        for box in boxes:
            render_tile(renderer.spec(box), read, scratch)

    def bare() -> None:
        for frame, matrix, size in warps:
            cv2.warpPerspective(frame, matrix, size, flags=_FLAGS)

    ours()
    bare()
    # Both are measured in turn, so that a change of the CPU's clock rate affects both.
    pairs = [(_cpu_ms(ours), _cpu_ms(bare)) for _ in range(repetitions)]
    tiles = []
    for level in range(levels_of(grid)):
        reduced = grid.reduced(2**level)
        small = TileRenderer(plan, projector, reduced)
        tiles += [_cpu_ms(lambda box=box, small=small: _encoded(small, box, read)) for box in _boxes(reduced)]  # type: ignore[misc]
    megapixels = grid.width * grid.height / 1e6
    return MosaicFigures(
        material=board.name,
        megapixels=round(megapixels, 2),
        repetitions=repetitions,
        plan_ms=round(statistics.median(_cpu_ms(planned) for _ in range(repetitions)), 1),
        mosaic_mpx_per_s=round(megapixels / statistics.median(a for a, _ in pairs) * 1e3, 1),
        mosaic_ratio_to_warp=round(statistics.median(b / a for a, b in pairs), 3),
        tile_ms_p50=round(float(np.percentile(tiles, 50)), 2),
        tile_ms_p95=round(float(np.percentile(tiles, 95)), 2),
    )


def _boxes(grid: MosaicGrid, size: tuple[int, int] = (TILE_PX, TILE_PX)) -> list[tuple[int, int, int, int]]:
    """Return all tiles of a grid, or parts of another width and height."""
    width, height = size
    return [
        (x, y, min(x + width, grid.width), min(y + height, grid.height))
        for y in range(0, grid.height, height)
        for x in range(0, grid.width, width)
    ]


def _encoded(renderer: TileRenderer, box: tuple[int, int, int, int], read: Callable[[int, int], Any]) -> None:
    picture = render_tile(renderer.spec(box), read)
    if picture is not None:
        encode_jpeg(picture)


def _cpu_ms(work: Callable[[], Any]) -> float:
    start = time.process_time()
    work()
    return (time.process_time() - start) * 1e3

"""Memory of a large mosaic: python -m tests.benchmarks.large_mosaic [PX_PER_MM]. Not a part of CI: it takes minutes.

A board of 400 × 410 mm under 12 cameras of 1392 × 1040 px at 40 px/mm: 262 megapixels from 400 frames of noise. Prints
size, time and the largest resident memory of the process.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.model import BoardType, Stitch
from vaoi_station.mosaic import MosaicGrid, TakenFrame, choose_frames, make_plan
from vaoi_station.mosaic.tiles import write_mosaic
from vaoi_station.steps import completed

SCALE, WIDTH, HEIGHT, BOARD = 40.0, 1392, 1040, (400.0, 410.0)
PITCH, STEP, FILES = WIDTH / SCALE / 1.05, HEIGHT / SCALE / 2.1, 7


def main(px_per_mm: float = SCALE) -> None:
    cv2.setNumThreads(1)
    count, rows = int(np.ceil(BOARD[0] / PITCH)), int(np.ceil(BOARD[1] / STEP)) + 1
    cameras = tuple(
        Camera(
            WIDTH,
            HEIGHT,
            Projective(
                np.array([[SCALE, 0, WIDTH / 2 - SCALE * PITCH * (i + 0.5)], [0, SCALE, HEIGHT / 2], [0, 0, 1.0]]),
                System.IMAGE,
                System.ROW,
            ),
            Lens((0.0, 0.0), 1.0),
            working_distance_mm=483.0,
        )
        for i in range(count)
    )
    motion = tuple(np.array([[1, 0, 0], [0, 1, -STEP * j], [0, 0, 1.0]]) for j in range(rows))
    g = np.random.default_rng(0)
    parts = [{"ref": f"U{n}", "center": g.uniform(10, 390, 2).tolist(), "width": 6, "height": 4} for n in range(1000)]
    board = BoardType.model_validate(
        {"name": "large", "y_axis": "down", "outline": [[0, 0], BOARD], "components": parts}
    )
    matrices = tuple(tuple(c.image_from_row.matrix @ d for d in motion) for c in cameras)
    stitch = Stitch(method="x", image_matrices=matrices, cad_matrix=np.eye(3), row_motion=motion, status="ok")
    taken = [TakenFrame(i, j, 250.0) for j in range(rows) for i in range(count)]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{n}.png" for n in range(FILES)]
        for file in files:
            small = g.integers(40, 200, (HEIGHT // 8, WIDTH // 8)).astype(np.uint8)
            cv2.imwrite(str(file), cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC))

        def read(camera: int, row: int) -> np.ndarray:
            return np.asarray(cv2.imread(str(files[(camera + 3 * row) % FILES]), cv2.IMREAD_UNCHANGED))

        projector, began = FrameIndex.of_result(stitch, cameras), time.monotonic()
        base = MosaicGrid.of_board(board, SCALE)
        chosen = choose_frames(taken)
        plan = completed(make_plan(chosen, read, projector=projector, board_type=board, stitch=stitch, base=base))
        planned = time.monotonic()
        layout = write_mosaic(Path(folder) / "large.tif", plan, projector, MosaicGrid.of_board(board, px_per_mm), read)
        done = time.monotonic()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{layout.width}×{layout.height} px from {len(taken)} frames: plan {planned - began:.0f} s, "
        f"file of {layout.bytes / 1e6:.0f} MB {done - planned:.0f} s, covered {plan.covered:.3f}, peak {peak:.0f} MiB"
    )


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]))

"""The measurements, each a few repetitions of which the median counts."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.benchmarks.frames import Material
from vaoi_station.geometry.robust import Failure
from vaoi_station.model import Stitch
from vaoi_station.rendering import ViewCalculator, render
from vaoi_station.stitching.baseline import paper_features as paper
from vaoi_station.stitching.matching.evidence import Evidence
from vaoi_station.stitching.matching.prepared_frame import to_eight_bit, to_grey
from vaoi_station.stitching.work import TaskRunner, all_tasks


@dataclass(frozen=True)
class Figures:
    """What one run of the benchmark found; times are CPU time of one thread unless said otherwise."""

    material: str
    cameras: int
    rows: int
    frame_px: tuple[int, int]
    repetitions: int
    stitch_ms_per_frame: float
    """From frame to finished matrices, fiducials and C included."""
    stitch_spread_ms: tuple[float, float]
    paper_ms_per_frame: float
    ratio_to_paper_method: float
    paper_failed: str
    ready_after_last_frame_ms: float
    """Wall time of the last row's tasks and the adjustment, one thread, everything before being done."""
    images_per_s: float
    """Component images, views included, on one thread."""
    render_ratio_to_warp: float
    """Time of bare cv2.warpPerspective of the same crops over ours."""
    status: str
    cad_sigma_px: float | None
    opencv: str

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def measure(material: Material, repetitions: int = 5) -> Figures:
    """Measure everything on one board."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return _measure(material, repetitions)
    finally:
        cv2.setNumThreads(threads)


def _measure(material: Material, repetitions: int) -> Figures:
    stitch = _stitch(material)
    frames = len(material.frames)
    ours, theirs = [], []
    failed = ""
    for _ in range(repetitions):
        ours.append(_cpu_ms(lambda: _stitch(material)) / frames)
    for _ in range(max(repetitions // 2, 1)):
        theirs.append(_cpu_ms(lambda: _paper(material)) / frames)
    outcome = _paper(material)
    if isinstance(outcome, Failure):
        failed = outcome.reason
    ready = [_ready_ms(material) for _ in range(repetitions)]
    per_second, ratio = _rendering(material, stitch, repetitions)
    head = material.head
    return Figures(
        material=material.name,
        cameras=len(head.cameras),
        rows=head.rows,
        frame_px=(head.cameras[0].width, head.cameras[0].height),
        repetitions=repetitions,
        stitch_ms_per_frame=round(statistics.median(ours), 3),
        stitch_spread_ms=(round(min(ours), 3), round(max(ours), 3)),
        paper_ms_per_frame=round(statistics.median(theirs), 2),
        ratio_to_paper_method=round(statistics.median(theirs) / statistics.median(ours), 2),
        paper_failed=failed,
        ready_after_last_frame_ms=round(statistics.median(ready), 2),
        images_per_s=round(per_second, 1),
        render_ratio_to_warp=round(ratio, 3),
        status=stitch.status.value,
        cad_sigma_px=stitch.quality["cad_sigma_px"],
        opencv=cv2.__version__,
    )


def _stitch(material: Material) -> Stitch:
    times_s = material.head.row_times_s()
    runner = TaskRunner(material.setup, lambda i, j: material.frames.get((i, j)))
    present = sorted(material.frames, key=lambda key: (key[1], key[0]))
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), material.setup)]
    return runner.conclude(times_s, present, evidence)


def _paper(material: Material) -> Any:
    def grey(camera: int, row: int) -> NDArray[np.uint8]:
        return to_eight_bit(to_grey(material.frames[camera, row]))

    return paper.chain_rows(material.setup.cameras, material.head.rows, grey)


def _ready_ms(material: Material) -> float:
    """Everything but the last row's tasks is done beforehand; the clock runs for the rest."""
    times_s = material.head.row_times_s()
    runner = TaskRunner(material.setup, lambda i, j: material.frames.get((i, j)))
    present = list(material.frames)
    last = max(row for _, row in present)
    tasks = all_tasks(present, dict(enumerate(times_s)), material.setup)
    late = [t for t in tasks if last in {t.a[1], (t.b or t.a)[1]}]
    evidence: list[Evidence] = [runner.perform(t) for t in tasks if t not in set(late)]
    start = time.perf_counter()
    evidence += [runner.perform(t) for t in late]
    runner.conclude(times_s, present, evidence)
    return (time.perf_counter() - start) * 1e3


def _rendering(material: Material, stitch: Stitch, repetitions: int) -> tuple[float, float]:
    """Component images per second, and bare warps of the same crops over ours."""
    cameras = material.setup.cameras
    if stitch.cad_matrix is None:
        return 0.0, 0.0

    def ours() -> int:
        views = ViewCalculator(material.board_type, stitch, cameras).compute_all(material.board_type.components)
        for view in chain.from_iterable(views.values()):
            render(view, material.frames[view.camera, view.row])
        return sum(map(len, views.values()))

    views = ViewCalculator(material.board_type, stitch, cameras).compute_all(material.board_type.components)
    crops = list(chain.from_iterable(views.values()))

    def bare() -> None:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        for v in crops:
            frame, matrix = material.frames[v.camera, v.row], v.image_from_crop.matrix
            cv2.warpPerspective(frame, matrix, (v.width, v.height), flags=flags)

    count = ours()
    bare()
    pairs = [(_cpu_ms(ours), _cpu_ms(bare)) for _ in range(repetitions)]
    ours_ms = statistics.median(a for a, _ in pairs)
    return count / ours_ms * 1e3, statistics.median(b / a for a, b in pairs)


def _cpu_ms(work: Callable[[], Any]) -> float:
    start = time.process_time()
    work()
    return (time.process_time() - start) * 1e3

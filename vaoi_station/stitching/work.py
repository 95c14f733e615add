"""Divide a run into tasks: which there are, when they become possible, and how one is performed.

Tasks depend on frames alone, never on one another. They can run in any process and any order, as soon as their
frames are present, and the evidence they return is the same in the live station and offline.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.stitching.adjustment.observations import LinkStore
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.fiducial_detection import detect_marks
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.conclude import PriorKnowledge, conclude
from vaoi_station.stitching.matching.evidence import Detections, Evidence, FrameKey, Links, Task
from vaoi_station.stitching.matching.link import FramePair, link_neighbours, link_reference, link_rows
from vaoi_station.stitching.matching.overlap import overlap_share
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import METHODS, MethodName
from vaoi_station.stitching.quality.findings import Findings

_KEPT_ROWS, _KEPT_MORE = 3, 4
"""Prepared frames that a runner keeps: this number of rows, and a few more."""
_KEPT_STRIPS = 1024
"""Entries of the caches of overlaps; they depend on cameras and time steps, of which a station has few."""
_AT_REST = np.zeros(2)
"""Nominal shift between frames of one row, mm."""
_WIDE_PX = 110.0
"""Least width of the strip that rows j and j + 2 share, for a link between them: three patches. A narrower strip, in
which a patch and its margin fit once, costs as much as any pair of frames and improves σ by 3 to 8 per cent only."""


@dataclass(frozen=True)
class StitchSetup:
    """What is known before a board is filmed; the same for all frames of a run."""

    cameras: tuple[Camera, ...]
    conveyor_mm_s: tuple[float, float]
    trigger_period_s: float
    board_type: BoardType | None
    expectation: Expectation = field(default_factory=Expectation)
    method: MethodName = "auto"
    reference: Reference | None = None
    """A stitched run of the board type."""

    @cached_property
    def plane(self) -> BoardPlane | None:
        """The board type's plane as these cameras see it."""
        return None if self.board_type is None else board_plane(self.board_type, self.cameras[0])


def possible_tasks(
    new: FrameKey, present: Collection[FrameKey], times_s: Mapping[int, float], setup: StitchSetup
) -> tuple[Task, ...]:
    """Return the tasks that a newly arrived good frame makes possible.

    Args:
        new: camera and row of the frame.
        present: all good frames that have arrived, with or without `new`; a set is fastest.
        times_s: time of each row's pulse, by row.
        setup: cameras, belt, board type and method.
    """
    return tuple(_tasks_of(new, lambda key: key in present, times_s, setup))


def all_tasks(present: Collection[FrameKey], times_s: Mapping[int, float], setup: StitchSetup) -> tuple[Task, ...]:
    """Return the canonical tasks of a finished run, row by row: their evidence determines the result."""
    frames = set(present)
    in_order = sorted(frames, key=lambda key: (key[1], key[0]))
    there = frames.__contains__
    tasks = [task for key in in_order for task in _tasks_of(key, there, times_s, setup, only_ahead=True)]
    # bridges depend on rows that are missing for good, which is known only at the end of a run
    if bridges := _bridges(frames, times_s, setup):
        known = set(tasks)
        tasks += [task for task in bridges if task not in known]
    return tuple(tasks)


class TaskRunner:
    """Performs the tasks of one run, and concludes it; keeps the frames it prepared last."""

    def __init__(
        self,
        setup: StitchSetup,
        frame: Callable[[int, int], NDArray[Any] | None],
        reference_frame: Callable[[int, int], NDArray[Any] | None] | None = None,
    ) -> None:
        """Take functions that return the pixels of camera and row: of the run, and of the reference."""
        self._setup = setup
        self._frame = frame
        self._reference_frame = reference_frame
        self._prepared: OrderedDict[FrameKey, PreparedFrame] = OrderedDict()
        self._link_store = LinkStore(setup.cameras)

    def perform(self, task: Task) -> Links | Detections:
        """Perform one task; a task that finds nothing returns evidence with a note, not an error."""
        found = self._perform(task)
        self.add_evidence(found)
        return found

    def add_evidence(self, evidence: Evidence) -> None:
        """Take evidence of any process for the conclusion here; work done now is not left for the end of the run."""
        # links to the reference do not enter the adjustment of the rows
        if isinstance(evidence, Links) and evidence.task.kind != "reference":
            self._link_store.add(evidence)

    def _perform(self, task: Task) -> Links | Detections:
        setup = self._setup
        if task.kind == "marks":
            fixture = METHODS[setup.method].fixture
            return detect_marks(task, self._get(task.a), setup.cameras[task.a[0]], setup.board_type, fixture=fixture)
        assert task.b is not None
        a, camera_a = self._get(task.a), setup.cameras[task.a[0]]
        if task.kind == "reference":
            return link_reference(task, FramePair(a, self._reference(task.b), camera_a, camera_a, _AT_REST))
        b, camera_b = self._get(task.b), setup.cameras[task.b[0]]
        if task.kind == "neighbours":
            return link_neighbours(task, FramePair(a, b, camera_a, camera_b, _AT_REST))
        shift_mm = np.asarray(setup.conveyor_mm_s) * task.dt_s
        return link_rows(task, FramePair(a, b, camera_a, camera_b, shift_mm))

    def conclude(self, times_s: Floats, present: Collection[FrameKey], evidence: Iterable[Evidence]) -> Stitch:
        """Return the result of the run, once every frame is settled."""
        return self.conclude_with_findings(times_s, present, evidence)[0]

    def conclude_with_findings(
        self, times_s: Floats, present: Collection[FrameKey], evidence: Iterable[Evidence]
    ) -> tuple[Stitch, Findings]:
        """Return the result of the run, and the findings it rests on.

        Args:
            times_s: (m,) time of every row's pulse.
            present: the good frames.
            evidence: of `all_tasks`, in any order.
        """
        s = self._setup
        return conclude(
            Scene(s.cameras, tuple(sorted(present)), self._get),
            PriorKnowledge(
                s.plane, s.expectation, np.asarray(s.conveyor_mm_s, dtype=np.float64), s.method, s.reference
            ),
            np.asarray(times_s, dtype=np.float64),
            list(evidence),
            self._link_store,
        )

    def _reference(self, key: FrameKey) -> PreparedFrame:
        pixels = self._reference_frame(*key) if self._reference_frame is not None else None
        if pixels is None:
            raise LookupError(f"frame of camera {key[0]}, row {key[1]} of the reference is not there")
        # not kept: each frame of a reference is linked to one frame of the run
        return PreparedFrame(pixels)

    def _get(self, key: FrameKey) -> PreparedFrame:
        if key in self._prepared:
            self._prepared.move_to_end(key)
            return self._prepared[key]
        pixels = self._frame(*key)
        if pixels is None:
            raise LookupError(f"frame of camera {key[0]}, row {key[1]} is not there")
        # workers take frames in the order of rows: the least recently used frame is one of a row that is done
        self._prepared[key] = PreparedFrame(pixels)
        if len(self._prepared) > _KEPT_ROWS * len(self._setup.cameras) + _KEPT_MORE:
            self._prepared.popitem(last=False)
        return self._prepared[key]


def _tasks_of(
    key: FrameKey,
    there: Callable[[FrameKey], bool],
    times_s: Mapping[int, float],
    setup: StitchSetup,
    *,
    only_ahead: bool = False,
) -> list[Task]:
    """Return the tasks of a frame whose partner is present; with `only_ahead` those with later rows and cameras.

    Every task of two frames is ahead of exactly one of them, so that `only_ahead` lists each task once.
    """
    camera, row = key
    method, tasks = METHODS[setup.method], []
    if method.links:
        pairs = ((row, row + 1), (row, row + 2), (row - 1, row), (row - 2, row))[: 2 if only_ahead else 4]
        tasks += [
            _link((camera, p), (camera, q), times_s)
            for p, q in pairs
            if p in times_s and q in times_s and there((camera, p + q - row))
            if q - p == 1 or _strip_px(setup.cameras[camera], setup.conveyor_mm_s, _dt_s(p, q, times_s)) >= _WIDE_PX
        ]
        for left in (camera,) if only_ahead else (camera, camera - 1):
            if 0 <= left < len(setup.cameras) - 1 and there((2 * left + 1 - camera, row)):
                tasks.append(Task("neighbours", (left, row), (left + 1, row)))
    if method.marks and setup.board_type is not None and setup.board_type.fiducials:
        tasks.append(Task("marks", key))
    if method.reference and setup.reference is not None and (task := setup.reference.task(key)):
        tasks.append(task)
    return tasks


@lru_cache(maxsize=_KEPT_STRIPS)
def _strip_px(camera: Camera, velocity_mm_s: tuple[float, float], dt_s: float) -> float:
    """Return the shorter side of the overlap of two frames of a camera at nominal motion; ≤ 0: no overlap."""
    # plain floats: this runs for every frame that arrives, and numpy takes longer for a single point
    (a, b, c), (d, e, f), (g, h, i) = camera.image_from_row.matrix.tolist()
    u, v = camera.center_px
    x, y = _middle_mm(camera)
    x, y = x + velocity_mm_s[0] * dt_s, y + velocity_mm_s[1] * dt_s
    w = g * x + h * y + i
    return float(
        min(camera.width_px - abs((a * x + b * y + c) / w - u), camera.height_px - abs((d * x + e * y + f) / w - v))
    )


@lru_cache(maxsize=_KEPT_STRIPS)
def _middle_mm(camera: Camera) -> tuple[float, float]:
    """Return the point of the belt at the centre of the undistorted frame."""
    x, y = camera.row_from_image(camera.center_px).tolist()
    return x, y


def _bridges(frames: set[FrameKey], times_s: Mapping[int, float], setup: StitchSetup) -> list[Task]:
    """Return links across missing rows, wherever the frames before and after still overlap."""
    tasks: list[Task] = []
    if not METHODS[setup.method].links:
        return tasks
    for i, camera in enumerate(setup.cameras):
        rows = sorted(r for c, r in frames if c == i)
        for p, q in pairwise(rows):
            task = _link((i, p), (i, q), times_s)
            if q - p > 1 and overlap_share(camera, np.asarray(setup.conveyor_mm_s) * task.dt_s) > 0:
                tasks.append(task)
    return tasks


def _link(a: FrameKey, b: FrameKey, times_s: Mapping[int, float]) -> Task:
    return Task("rows", a, b, _dt_s(a[1], b[1], times_s))


def _dt_s(p: int, q: int, times_s: Mapping[int, float]) -> float:
    """Return the time from one row to another."""
    # rounded to a microsecond: equal steps are then equal keys of tasks and caches
    return round(float(times_s[q] - times_s[p]), 6)

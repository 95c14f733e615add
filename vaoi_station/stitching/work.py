"""Divide the stitching of a run into tasks: list them, find those that a new frame makes possible, and perform them.

A task depends on its one or two frames only, never on another task. Tasks can therefore run in any process and in any
order as soon as their frames are present. They return the same evidence in the live station and offline.
"""

from __future__ import annotations

import pickle
from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import VISIBILITY, BoardType, RecordingHead, Stitch, Visibility
from vaoi_station.steps import Steps, completed
from vaoi_station.stitching.adjustment.problem import LinkStore
from vaoi_station.stitching.adjustment.solver import Unknowns
from vaoi_station.stitching.board.board_plane import BoardPlane, board_plane
from vaoi_station.stitching.board.fiducials import detect_marks
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.conclude import Beginning, PriorKnowledge, Stitcher, explained
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import (
    METHODS,
    Detections,
    Evidence,
    FrameKey,
    Links,
    MethodName,
    Task,
    by_rows,
)
from vaoi_station.stitching.matching.frame_pair import FramePair, overlap_share
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.matching.link import link_neighbours, link_reference, link_rows
from vaoi_station.stitching.matching.relinking import Relinker
from vaoi_station.stitching.quality.findings import Findings

_KEPT_ROWS, _KEPT_MORE = 3, 4
"""A task runner keeps the prepared frames of `_KEPT_ROWS` complete rows, and `_KEPT_MORE` further ones."""
_KEPT_STRIPS = 1024
"""Entries of the caches of overlap sizes. A key is a camera and a time step, of which a station has only few."""
_AT_REST = np.zeros(2)
"""Nominal motion of the board between two frames of the same row, mm: none."""
_WIDE_PX = 110.0
"""Rows j and j + 2 are linked only if their overlap is at least this wide: three patches.

In a narrower overlap there is room for only one patch. Linking it takes as long as any pair of frames, but improves σ
by only 3 to 8 %."""


@dataclass(frozen=True)
class StitchSetup:
    """The settings of stitching that are fixed before a board is filmed and are the same for all frames of a run.

    It is pickled once, however many runs and workers it is sent to, and a worker that has it need not unpickle it
    again: with the 3000 components of a large board either takes 25 ms.
    """

    cameras: tuple[Camera, ...]
    conveyor_mm_s: tuple[float, float]
    trigger_period_s: float
    board_type: BoardType | None
    expectation: Expectation = field(default_factory=Expectation)
    method: MethodName = "auto"
    reference: Reference | None = None
    """A stitched run of the same board type, to which the frames are linked; None without one."""
    visibility: Visibility = VISIBILITY
    """How much of every component the frames must show, unless the board type states something else."""
    lights: tuple[str, ...] = ()
    """Names of the lights of the rows, in turn: row j has light j modulo their number. Empty if all rows have one."""
    channels: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """LED channels of every light, which the reason for a dark light names; empty if they are not known."""

    @cached_property
    def plane(self) -> BoardPlane | None:
        """The board plane of the board type for the cameras of this set-up; None without a board type."""
        return None if self.board_type is None else board_plane(self.board_type, self.cameras[0])

    @cached_property
    def shortest_run(self) -> int:
        """Least number of rows of a complete board, whichever way it lies; 0 if it is not known."""
        step_mm = float(np.hypot(*self.conveyor_mm_s)) * self.trigger_period_s
        if self.board_type is None or step_mm == 0:
            return 0
        low, high = self.board_type.extent()
        return int(float((high - low).min()) * self.board_type.mm_per_unit / step_mm)

    @cached_property
    def packed(self) -> bytes:
        """The pickled settings, without what was computed from them."""
        return pickle.dumps([getattr(self, f.name) for f in fields(self)], pickle.HIGHEST_PROTOCOL)

    def __reduce__(self) -> tuple[Callable[[bytes], StitchSetup], tuple[bytes]]:
        """Return how the receiver makes the set-up again, for `copy` and `pickle`."""
        return _unpacked, (self.packed,)

    def light(self, row: int) -> str:
        """Return the name of the light of a row; an empty text if all rows have one light."""
        return self.lights[row % len(self.lights)] if self.lights else ""

    def next_alike(self, row: int, step: int) -> int:
        """Return the next row of the same light in the direction `step`, 1 or −1; it may be before the first row."""
        return next(
            row + step * n for n in range(1, len(self.lights) + 1) if self.light(row + step * n) == self.light(row)
        )


# The boards of one order follow one another, so that the last one is enough.
@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> StitchSetup:
    return StitchSetup(*pickle.loads(packed))


def possible_tasks(
    new: FrameKey, present: Collection[FrameKey], times_s: Mapping[int, float], setup: StitchSetup
) -> tuple[Task, ...]:
    """Return the tasks that a newly arrived good frame makes possible; `present` may contain `new` or not."""
    return tuple(_tasks_of(new, lambda key: key in present, times_s, setup))


def all_tasks(present: Collection[FrameKey], times_s: Mapping[int, float], setup: StitchSetup) -> tuple[Task, ...]:
    """Return the canonical tasks of a run whose frames are all settled, row by row.

    The evidence of these tasks, and no other evidence, determines the result of the run.
    """
    frames = set(present)
    in_order = sorted(frames, key=lambda key: (key[1], key[0]))
    there = frames.__contains__
    tasks = [task for key in in_order for task in _tasks_of(key, there, times_s, setup, only_ahead=True)]
    # A bridge links the rows before and after missing rows. Which rows are missing is known only at the end of a run.
    if bridges := _bridges(frames, times_s, setup):
        known = set(tasks)
        tasks += [task for task in bridges if task not in known]
    return tuple(tasks)


class TaskRunner:
    """Performs the tasks of one run and concludes the run. It keeps the prepared frames that were used last."""

    def __init__(
        self,
        setup: StitchSetup,
        frame: Callable[[int, int], NDArray[Any] | None],
        reference_frame: Callable[[int, int], NDArray[Any] | None] | None = None,
    ) -> None:
        """Create the runner of one run.

        `frame` returns the pixels of a camera and row, or None if the frame is missing; `reference_frame` does the same
        for the frames of the reference.
        """
        self._setup = setup
        self._frame = frame
        self._reference_frame = reference_frame
        self._prepared: OrderedDict[FrameKey, PreparedFrame] = OrderedDict()
        self._link_store = LinkStore(setup.cameras)
        self._relinker = Relinker(setup.cameras, np.array(setup.conveyor_mm_s), self._get, self._link_store.motions_mm)
        self._arrived: dict[tuple[int, int], list[Links]] = {}
        self._complete: deque[list[Links]] = deque()
        self._preparing: Steps[None] | None = None
        # All evidence by its last row, up to the first row of which some is missing, and what is begun with it.
        self._of_row: dict[int, list[Evidence]] = {}
        self._rows, self._times_s = 0, {0: 0.0}
        self._awaited = (-1, 0)  # a row, and how much evidence it has if all its frames are good
        self._beginning: Steps[None] | None = None
        self._begun: dict[int, tuple[Beginning, Unknowns | None]] = {}  # by the number of rows, of the last two

    def add_evidence(self, evidence: Evidence) -> None:
        """Take evidence, of any process, for `prepare`."""
        task = evidence.task
        if task.kind != "reference":
            row = (task.b or task.a)[1]
            self._of_row.setdefault(row, []).append(evidence)
            if row == task.a[1] + 1 and task.a[1] in self._times_s:
                self._times_s[row] = self._times_s[row - 1] + task.dt_s
        if isinstance(evidence, Links) and evidence.task.kind != "reference":
            own = self._arrived.setdefault(evidence.rows, [])
            own.append(evidence)
            if len(own) == len(self._setup.cameras) - (evidence.task.kind == "neighbours"):
                self._complete.append(self._arrived.pop(evidence.rows))

    def prepare(self) -> bool:
        """Do a part, of milliseconds, of what the conclusion of the run needs; return False if nothing is possible yet.

        It is what depends on the links and frames of two rows only and for which the links of all cameras have arrived,
        and the adjustment of all rows that have arrived, with which that of the whole run begins if only one row
        follows. The conclusion does what is missing, with the same result.
        """
        if self._preparing is None and self._complete:
            self._preparing = self._steps(tuple(sorted(self._complete.popleft(), key=lambda e: e.task.a)))
        # Without a frame that another process has linked, a step ends here.
        if self._preparing is not None:
            steps, self._preparing = self._preparing, None
            with suppress(StopIteration, LookupError):
                next(steps)
                self._preparing = steps
            return True
        self._beginning = self._next_beginning() or self._beginning
        if self._beginning is None:
            return False
        steps, self._beginning = self._beginning, None
        with suppress(StopIteration, LookupError):
            next(steps)
            self._beginning = steps
        return True

    def _next_beginning(self) -> Steps[None] | None:
        """Begin with the rows that have arrived if these are more than before; return None if they are not.

        It takes as long as a conclusion, so it is not done while more of the board is surely to come.
        """
        rows = None
        while self._settled(self._rows):
            self._rows, rows = self._rows + 1, self._rows + 1
        if rows is None or rows < self._setup.shortest_run:
            return None
        every = [e for row in range(rows) for e in self._of_row[row]]
        links, marks = (e for e in every if isinstance(e, Links)), (e for e in every if isinstance(e, Detections))
        beginning = Beginning.of(by_rows(links), marks, rows)
        return None if beginning is None else self._begin(beginning)

    def _settled(self, row: int) -> bool:
        """Return whether all evidence of a row and those before it has arrived, if all its frames are good."""
        found = self._of_row.get(row)
        if found is None or row not in self._times_s:
            return False
        if self._awaited[0] != row:
            frames = [(camera, row) for camera in range(len(self._setup.cameras))]
            times_s = {r: time_s for r, time_s in self._times_s.items() if r <= row}
            tasks = {task for key in frames for task in _tasks_of(key, lambda _: True, times_s, self._setup)}
            self._awaited = row, sum(task.kind != "reference" for task in tasks)
        return len(found) == self._awaited[1]

    def _begin(self, beginning: Beginning) -> Steps[None]:
        stitcher = self._stitcher(np.array(beginning.times_s), beginning.present, ())
        rows = len(beginning.times_s)
        self._begun[rows] = beginning, (yield from stitcher.begin(beginning))
        # The last row, too, may have arrived before the run is concluded, which then begins with the rows before it.
        self._begun = {n: begun for n, begun in self._begun.items() if n >= rows - 1}

    def _first_rows(self, beginning: Beginning) -> Unknowns | None:
        """Return the unknowns of all rows but the last one, which may have been computed before the last row."""
        rows = len(beginning.times_s)
        if rows not in self._begun or self._begun[rows][0] != beginning:
            completed(self._begin(beginning))
        return self._begun[rows][1]

    def _steps(self, links: tuple[Links, ...]) -> Steps[None]:
        self._link_store.part(links)
        yield
        if links[0].task.kind == "rows":
            for own in (yield from self._relinker.prepare(links)):
                part = self._link_store.part(own)
                _ = part.used and part.step
                yield
        # What has arrived of later rows may still change.
        self._link_store.lay(links[0].rows[1] - 1)

    def perform(self, task: Task) -> Links | Detections:
        """Perform one task and return its evidence. A task that finds nothing returns empty evidence, not an error."""
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

    def conclude(
        self,
        times_s: Floats,
        present: Collection[FrameKey],
        evidence: Iterable[Evidence],
        doubts: tuple[str, ...] = (),
    ) -> Stitch:
        """Return the result of the run, once every frame is settled."""
        return self.conclude_with_findings(times_s, present, evidence, doubts)[0]

    def conclude_with_findings(
        self,
        times_s: Floats,
        present: Collection[FrameKey],
        evidence: Iterable[Evidence],
        doubts: tuple[str, ...] = (),
    ) -> tuple[Stitch, Findings]:
        """Return the result of the run, and the findings from which it was derived."""
        answer, findings = self.answer(times_s, present, evidence, doubts)
        return explained(answer, findings), findings

    def answer(
        self,
        times_s: Floats,
        present: Collection[FrameKey],
        evidence: Iterable[Evidence],
        doubts: tuple[str, ...] = (),
    ) -> tuple[Stitch, Findings]:
        """Return the result of the run without what only explains its verdict (`conclude.explained`), and the findings.

        `doubts` are those about the frames that arose when they were recorded (`RecordingHead.doubts`).
        """
        self._complete.clear()
        self._preparing = self._beginning = None
        return self._stitcher(np.asarray(times_s, np.float64), present, doubts).stitch(list(evidence))

    def _stitcher(self, times_s: Floats, present: Collection[FrameKey], doubts: tuple[str, ...]) -> Stitcher:
        s = self._setup
        velocity_mm_s = np.asarray(s.conveyor_mm_s, dtype=np.float64)
        reference_frame = self._reference if self._reference_frame is not None else None
        lights = tuple(s.light(row) for row in range(len(times_s))) if s.lights else ()
        prior = PriorKnowledge(
            s.plane, s.expectation, velocity_mm_s, s.method, s.reference, s.visibility, reference_frame, lights,
            s.channels,
        )  # fmt: skip
        scene = Scene(s.cameras, tuple(sorted(present)), self._get, doubts)
        return Stitcher(scene, prior, times_s, self._link_store, self._relinker, self._first_rows)

    def _reference(self, key: FrameKey) -> PreparedFrame:
        """Return a prepared frame of the reference; raise LookupError if the reference lacks it."""
        pixels = self._reference_frame(*key) if self._reference_frame is not None else None
        if pixels is None:
            raise LookupError(f"frame of camera {key[0]}, row {key[1]} of the reference is not there")
        # the prepared frame is not kept: each frame of a reference is linked to only one frame of the run
        return PreparedFrame(pixels)

    def _get(self, key: FrameKey) -> PreparedFrame:
        """Return a prepared frame of the run, from the kept ones if possible; raise LookupError if it is missing."""
        if key in self._prepared:
            self._prepared.move_to_end(key)
            return self._prepared[key]
        pixels = self._frame(*key)
        if pixels is None:
            raise LookupError(f"frame of camera {key[0]}, row {key[1]} is not there")
        # workers use frames row by row: the least recently used frame belongs to a row whose tasks are done
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
    """Return the tasks in which a frame takes part and whose other frame is present.

    With `only_ahead`, the other frame is of a later row or of the next camera only. If the tasks of all frames of a run
    are listed in this way, each task occurs exactly once.
    """
    camera, row = key
    method, tasks = METHODS[setup.method], []
    if method.links:
        ahead, back = _rows_to_link(row, 1, setup), () if only_ahead else _rows_to_link(row, -1, setup)
        pairs = (*((row, q) for q in ahead), *((p, row) for p in back))
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


def _rows_to_link(row: int, step: int, setup: StitchSetup) -> tuple[int, ...]:
    """Return the rows to which a row is linked in the direction `step`, 1 or −1: the next one, and the one after it.

    If the light changes from row to row, the row after the next is replaced by the next row of the same light: what
    metal looks like moves with the lamp, so that links between two lights have an error in common.
    """
    if len(set(setup.lights)) < 2:
        return row + step, row + 2 * step
    alike = setup.next_alike(row, step)
    return (row + step,) if alike == row + step else (row + step, alike)


@lru_cache(maxsize=_KEPT_STRIPS)
def _strip_px(camera: Camera, velocity_mm_s: tuple[float, float], dt_s: float) -> float:
    """Return the shorter side in px of the overlap of two frames that one camera takes `dt_s` apart; ≤ 0 for none."""
    # Plain floats are used, because numpy takes longer for a single point, and this runs for every frame that arrives.
    (a, b, c), (d, e, f), (g, h, i) = camera.image_from_row.matrix.tolist()
    u, v = camera.center_px
    x, y = camera.row_from_image(camera.center_px).tolist()
    x, y = x + velocity_mm_s[0] * dt_s, y + velocity_mm_s[1] * dt_s
    w = g * x + h * y + i
    return float(
        min(camera.width_px - abs((a * x + b * y + c) / w - u), camera.height_px - abs((d * x + e * y + f) / w - v))
    )


def _bridges(frames: set[FrameKey], times_s: Mapping[int, float], setup: StitchSetup) -> list[Task]:
    """Return the tasks that link the last frame before missing rows to the first after them, where the two overlap."""
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
    """Return the task that links two frames of one camera."""
    return Task("rows", a, b, _dt_s(a[1], b[1], times_s))


def _dt_s(p: int, q: int, times_s: Mapping[int, float]) -> float:
    """Return the time in s from the pulse of row p to the pulse of row q."""
    # rounded to a microsecond, so that nominally equal steps are the same key in caches and equal in tasks
    return round(float(times_s[q] - times_s[p]), 6)


Frames = Callable[[int, int], NDArray[Any] | None]
KEPT_BYTES = 256_000_000
"""Size of the frames of a run that stay in memory while it is stitched."""


def kept_frames(frame: Frames, most_bytes: int = KEPT_BYTES) -> Frames:
    """Return a function that keeps the first frames it returns, up to a size, and reads the others each time.

    The conclusion of a run reads every frame several times, in other orders than the tasks.
    """
    kept: dict[tuple[int, int], NDArray[Any]] = {}
    room = most_bytes

    def kept_frame(camera: int, row: int) -> NDArray[Any] | None:
        nonlocal room
        if (pixels := kept.get((camera, row))) is not None:
            return pixels
        pixels = frame(camera, row)
        # No frame replaces a kept one: where all are read in turns, the one used longest ago is the one needed next.
        if pixels is not None and pixels.nbytes <= room:
            kept[camera, row] = pixels
            room -= pixels.nbytes
        return pixels

    return kept_frame


def stitch_frames(
    setup: StitchSetup, head: RecordingHead, frame: Frames, reference_frame: Frames | None = None
) -> Stitch:
    """Stitch the frames of a finished run; `frame` returns None where a frame never arrived."""
    # A run with missing frames is stitched from the other frames. Only the tasks of the missing frames are left out.
    lost = set(head.missing)
    present = [(i, j) for i in range(len(head.cameras)) for j in range(head.rows) if (i, j) not in lost]
    times_s = head.motion_times_s()
    runner = TaskRunner(setup, kept_frames(frame), reference_frame)
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
    return runner.conclude(times_s, present, evidence, head.doubts)

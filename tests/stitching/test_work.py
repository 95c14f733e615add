"""Stitching of a whole recording: frames that are missing are never asked for."""

from __future__ import annotations

import copy
import pickle
import sys
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.model import BoardType
from vaoi_station.runs.workers.warmup import warm_up
from vaoi_station.stitching.matching.evidence import FrameKey, Task
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks, possible_tasks, stitch_frames

BOARD = BoardType.model_validate(
    {
        "name": "b",
        "outline": [[0, 0], [30, 20]],
        "fiducials": [{"name": n, "x": x, "y": x, "diameter": 1.0} for n, x in (("A", 3), ("B", 17))],
    }
)


def setup_of(workshop: Any, cameras: int, board_type: BoardType | None = BOARD) -> StitchSetup:
    return StitchSetup(tuple(workshop.camera((15.0 * i, 0)) for i in range(cameras)), (0.0, 50.0), 0.1, board_type)


@st.composite
def arrivals(draw: st.DrawFn) -> tuple[int, int, list[FrameKey]]:
    """Cameras, rows, and the good frames in the order of their arrival."""
    n, m = draw(st.integers(1, 4)), draw(st.integers(1, 6))
    frames = draw(st.permutations([(i, j) for i in range(n) for j in range(m)]))
    lost = draw(st.sets(st.sampled_from(frames), max_size=4))
    return n, m, [f for f in frames if f not in lost]


@given(arrivals())
def test_tasks_do_not_depend_on_the_order_of_arrival(workshop: Any, arrived: tuple[int, int, list[FrameKey]]) -> None:
    n, m, frames = arrived
    setup = setup_of(workshop, n)
    times, all_times = {}, {j: 0.1 * j + 5 for j in range(m)}
    found: set[Task] = set()
    present: list[FrameKey] = []
    for camera, row in frames:
        times[row] = all_times[row]
        present.append((camera, row))
        new = possible_tasks((camera, row), present, times, setup)
        assert not found & set(new), "no task is returned twice"
        assert all((camera, row) in (t.a, t.b) for t in new)
        found |= set(new)
    canonical = all_tasks(frames, all_times, setup)
    assert len(set(canonical)) == len(canonical)
    bridges = {t for t in canonical if t.kind == "rows" and t.b is not None and t.b[1] - t.a[1] > 1}
    assert found == set(canonical) - bridges
    assert canonical == all_tasks(frames[::-1], all_times, setup)


def test_rows_two_apart_are_linked_where_their_overlap_is_wide_enough(workshop: Any) -> None:
    """A frame is 160 px high; two steps of 2 mm leave a strip of 120 px, two of 3 mm one of 100 px."""
    frames, times = [(i, j) for i in range(2) for j in range(4)], {j: 0.1 * j for j in range(4)}
    slow, fast = (replace(setup_of(workshop, 2), conveyor_mm_s=(0.0, v)) for v in (20.0, 30.0))
    far = sorted((t for t in all_tasks(frames, times, slow) if t.b and t.b[1] - t.a[1] == 2), key=lambda t: t.a)
    assert far == [Task("rows", (i, p), (i, p + 2), 0.2) for i in range(2) for p in range(2)]
    assert {t for f in frames for t in possible_tasks(f, frames, times, slow)} >= set(far), "as soon as both are there"
    assert not [t for t in all_tasks(frames, times, fast) if t.b and t.b[1] - t.a[1] == 2]
    lost = [f for f in frames if f[1] != 1]
    assert [t for t in all_tasks(lost, times, slow) if t.b and t.b[1] - t.a[1] == 2] == [far[0], far[2]], (
        "no task twice"
    )


@pytest.mark.parametrize("board_type", [None, BoardType(name="bare", outline=((0, 0), (1, 1)))])
def test_without_fiducials_there_are_no_mark_tasks(workshop: Any, board_type: BoardType | None) -> None:
    assert all_tasks([(0, 0)], {0: 0.0}, setup_of(workshop, 1, board_type)) == ()


def test_a_missing_row_is_bridged_where_the_frames_still_overlap(workshop: Any) -> None:
    """A row moves 5 mm and a frame shows 16 mm: across one or two missing rows there is overlap, across three none."""
    setup, times = setup_of(workshop, 2), {j: 0.1 * j for j in range(6)}
    frames = [(i, j) for i in (0, 1) for j in range(6) if j != 2 and (i, j) != (1, 3)]
    bridges = [t for t in all_tasks(frames, times, setup) if t.b and t.b[1] - t.a[1] > 1]
    assert bridges == [Task("rows", (0, 1), (0, 3), 0.2), Task("rows", (1, 1), (1, 4), 0.3)]
    gap = [(0, 0), (0, 4), (0, 5)]
    assert not [t for t in all_tasks(gap, times, setup) if t.b and t.b[1] - t.a[1] > 1]


@settings(max_examples=3, deadline=None)
@given(st.randoms(use_true_random=False))
def test_evidence_and_result_do_not_depend_on_the_order_of_work(filmed: Any, random: Any) -> None:
    tasks = list(filmed.tasks)
    random.shuffle(tasks)
    runner = TaskRunner(filmed.setup, filmed.frame)
    evidence = [runner.perform(t) for t in tasks]
    again = runner.conclude(filmed.times_s, filmed.present[::-1], evidence)
    first = filmed.stitch
    assert again.model_dump(mode="json", exclude={"quality"}) == first.model_dump(mode="json", exclude={"quality"})
    timeless = [{k: v for k, v in s.quality.items() if k != "timings_ms"} for s in (again, first)]
    assert timeless[0] == timeless[1]


def test_a_warm_worker_compiles_nothing_when_a_board_arrives(filmed: Any) -> None:
    """Evidence arrives through a pipe; other types of arrays would be compiled for seconds while the board waits."""
    warm_up()
    modules = [m for name, m in sys.modules.items() if name.startswith("vaoi_station.")]
    compiled = {id(f): f for m in modules for f in vars(m).values() if hasattr(f, "py_func")}
    before = {key: set(f.signatures) for key, f in compiled.items()}
    assert sum(map(len, before.values())) > 30
    setup, present = pickle.loads(pickle.dumps((filmed.setup, filmed.present)))
    runner = TaskRunner(setup, filmed.frame)
    found = [pickle.loads(pickle.dumps(runner.perform(task))) for task in filmed.tasks]
    runner.answer(filmed.times_s, present, found)
    later = {f.py_func.__name__: set(f.signatures) - before[key] for key, f in compiled.items()}
    assert not {name: new for name, new in later.items() if new}


def test_rows_of_one_light_are_linked_across_the_rows_of_others(workshop: Any) -> None:
    """Of three lights in turn: the next row, and the next one of the same light, as soon as both frames are there."""
    frames, times = [(0, j) for j in range(8)], {j: 0.1 * j for j in range(8)}
    setup = replace(setup_of(workshop, 1), conveyor_mm_s=(0.0, 10.0), lights=("a", "b", "c"))
    rows = {(t.a[1], t.b[1]) for t in all_tasks(frames, times, setup) if t.kind == "rows" and t.b}
    assert rows == {(j, j + 1) for j in range(7)} | {(j, j + 3) for j in range(5)}
    found = [t for n, f in enumerate(frames[::-1]) for t in possible_tasks(f, frames[::-1][:n], times, setup)]
    assert {(t.a[1], t.b[1]) for t in found if t.kind == "rows" and t.b} == rows
    assert len(set(found)) == len(found)
    uneven = replace(setup, lights=("a", "a", "b"))
    pairs = {(t.a[1], t.b[1]) for t in all_tasks(frames, times, uneven) if t.kind == "rows" and t.b}
    assert {(0, 1), (1, 3), (3, 4), (4, 6)} <= pairs, "the next row of the same light is as near as it can be"
    assert {(1, 2), (2, 3)} <= pairs, "rows of two lights are linked, too: they may be the only connection"
    one = replace(setup, lights=("a", "a"))
    assert all_tasks(frames, times, one) == all_tasks(frames, times, replace(one, lights=()))


def test_a_set_up_arrives_as_it_was_sent(workshop: Any) -> None:
    sent = replace(setup_of(workshop, 2), lights=("a", "b"), channels={"a": (0, 1), "b": ()})
    other = setup_of(workshop, 1, None)
    for setup in (sent, other, sent):
        content = pickle.dumps(setup)
        found = pickle.loads(content)
        assert replace(found, cameras=()) == replace(setup, cameras=())
        assert [c.width_px for c in found.cameras] == [c.width_px for c in setup.cameras]
        assert pickle.loads(content) is found, "a worker that has it need not unpickle the board type again"
        assert replace(copy.deepcopy(setup), cameras=()) == replace(setup, cameras=())


def test_each_frame_is_read_once_and_missing_ones_are_not(filmed: Any) -> None:
    asked: list[tuple[int, int]] = []

    def frame(camera: int, row: int) -> Any:
        asked.append((camera, row))
        return filmed.frame(camera, row)

    head = filmed.head.model_copy(update={"missing": ((0, 1), (1, 4))})
    result = stitch_frames(filmed.setup, head, frame)
    assert sorted(asked) == [key for key in sorted(filmed.present) if key not in ((0, 1), (1, 4))]
    assert result.image_matrices[0][1] is not None, "the other camera places the row"

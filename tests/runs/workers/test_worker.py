"""The work of one worker, without a process: jobs on a real ring with a board of the twin."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.rendering.computed import compute_views
from tests.runs.workers.conftest import CHECK, WANTED, RingBoard
from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.lamps import is_comparable
from vaoi_station.errors import GoneError, InternalError
from vaoi_station.files.images import write_image
from vaoi_station.files.results import stitch_text
from vaoi_station.model import Status
from vaoi_station.runs.workers import evidence_log
from vaoi_station.runs.workers import worker as module
from vaoi_station.runs.workers.evidence_log import EvidenceLog, shared_memory
from vaoi_station.runs.workers.jobs import CloseRun, ExplainJob, Job, Numbered, Reply
from vaoi_station.runs.workers.picture_jobs import RenderJob
from vaoi_station.runs.workers.worker import WorkerRuntime
from vaoi_station.stitching.work import TaskRunner


@pytest.fixture
def logs() -> list[EvidenceLog]:
    memory = shared_memory(2)
    return [EvidenceLog(memory, k) for k in range(2)]


@contextmanager
def running(board: RingBoard, logs: list[EvidenceLog], index: int = 1) -> Iterator[WorkerRuntime]:
    """A worker with the run open; worker 1 is its owner."""
    with WorkerRuntime(str(board.ring.path), index, logs) as made:
        assert made.reply(dataclasses.replace(board.opening, owned=index == 1)) is None
        yield made


@pytest.fixture
def runtime(ring_board: RingBoard, logs: list[EvidenceLog]) -> Iterator[WorkerRuntime]:
    with running(ring_board, logs) as made:
        yield made


def only(runtime: WorkerRuntime, job: Job) -> Reply:
    reply = runtime.reply(Numbered(1, job))
    assert isinstance(reply, Reply)
    return reply


def matrices(reply: Reply) -> Any:
    assert reply.error is None, reply.error
    return json.loads(reply.value.document)["image_matrices"]


@pytest.fixture(scope="module")
def expected(ring_board: RingBoard) -> Any:
    """The matrices of the run, by one worker that finds all evidence itself when it concludes."""
    with running(ring_board, [EvidenceLog(shared_memory(2), 0)], 0) as alone:
        return matrices(only(alone, ring_board.conclusion()))


def test_a_result_does_not_depend_on_the_worker_that_found_the_evidence(
    ring_board: RingBoard, expected: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory, half = shared_memory(2), len(ring_board.tasks) // 2
    with (
        running(ring_board, [EvidenceLog(memory, k) for k in range(2)], 0) as helper,
        running(ring_board, [EvidenceLog(memory, k) for k in range(2)]) as owner,
    ):
        assert len(only(helper, ring_board.link(*ring_board.tasks[half:])).value) == len(ring_board.tasks) - half
        only(owner, ring_board.link(*ring_board.tasks[:half]))
        monkeypatch.setattr(TaskRunner, "perform", lambda *_: pytest.fail("all evidence is there"))
        assert matrices(only(owner, ring_board.conclusion())) == expected
        with running(ring_board, [EvidenceLog(memory, k) for k in range(2)]) as successor:
            assert matrices(only(successor, ring_board.conclusion())) == expected, "the owner has died"


def test_a_result_does_not_depend_on_what_its_owner_prepared(ring_board: RingBoard, expected: Any) -> None:
    """It prepares what another worker found, with frames of which it knows only by the other's log."""
    memory, last = shared_memory(2), max(task.a[1] for task in ring_board.tasks)
    with (
        running(ring_board, [EvidenceLog(memory, k) for k in range(2)], 0) as helper,
        running(ring_board, [EvidenceLog(memory, k) for k in range(2)]) as owner,
    ):
        only(helper, ring_board.link(*(task for task in ring_board.tasks if task.a[1] < last)))
        assert not owner.prepare(), "nothing has arrived"
        owner.gather()
        steps = 0
        while owner.prepare():
            steps += 1
        assert steps > last
        assert matrices(only(owner, ring_board.conclusion())) == expected


def test_a_new_owner_finds_again_what_was_overwritten(
    ring_board: RingBoard, expected: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evidence_log, "LOG_BYTES", 40_000)
    memory = shared_memory(2)
    with running(ring_board, [EvidenceLog(memory, k) for k in range(2)], 0) as helper:
        for task in ring_board.tasks:
            only(helper, ring_board.link(task))
    with running(ring_board, [EvidenceLog(memory, k) for k in range(2)]) as owner:
        assert matrices(only(owner, ring_board.conclusion())) == expected


def test_records_of_a_log_are_read_once_and_in_order_whatever_is_overwritten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evidence_log, "LOG_BYTES", 1000)
    memory = shared_memory(2)
    writer, reader = EvidenceLog(memory, 1), EvidenceLog(memory, 1)
    seen: list[int] = []
    for number in range(200):
        writer.write((number % 7 * "x", number, [], {}))
        if number % 3 == 0:
            seen += [generation for _, generation, *_ in reader.new_records()]
    assert seen == list(range(199))
    for number in range(200, 400):
        writer.write(("", number, [], {}))
    late = [generation for _, generation, *_ in reader.new_records()]
    assert late == list(range(late[0], 400)), "what a slow reader finds is whole"
    assert 200 < late[0] < 400
    assert [generation for _, generation, *_ in EvidenceLog(memory, 1).new_records()] == late
    assert list(writer.new_records()) == list(reader.new_records()) == []
    assert list(EvidenceLog(memory, 0).new_records()) == [], "logs do not touch each other"
    writer.write(("x" * 2000, 0, [], {}))
    assert list(reader.new_records()) == [], "it is too large for the log"


def test_a_record_that_is_not_whole_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    memory = shared_memory(1)
    writer, reader = EvidenceLog(memory, 0), EvidenceLog(memory, 0)
    writer.write(("broken", 1, [], {}))
    memory[30] ^= 255
    assert list(reader.new_records()) == []
    writer.write(("whole", 2, [], {}))
    assert list(reader.new_records()) == [("whole", 2, [], {})]


def test_an_answer_becomes_the_result_of_the_library_by_its_explanation(
    runtime: WorkerRuntime, ring_board: RingBoard
) -> None:
    """The verdict is that of the run, whose faults may have lowered it. A worker explains a result only once."""
    answer = only(runtime, ring_board.conclusion()).value
    assert runtime.reply(CloseRun("r1")) is None
    lowered = ExplainJob("r1", Status.DEGRADED, ("the belt stopped",), ("belt",))
    explained = only(runtime, lowered).value
    assert explained.check is None
    texts = answer.document, explained.document.value, library_text(ring_board)
    first, whole, library = (json.loads(text) for text in texts)
    assert (whole["status"], whole["reasons"], whole["reason_codes"]) == ("degraded", ["the belt stopped"], ["belt"])
    later = first["quality"].pop("later")
    assert set(later) == set(whole["quality"]) - set(first["quality"])
    for document in (first, whole, library):
        del document["quality"]["timings_ms"]
    assert whole["quality"] == library["quality"]
    assert {key: whole["quality"][key] for key in first["quality"]} == first["quality"]
    assert whole["image_matrices"] == first["image_matrices"] == library["image_matrices"]
    error = only(runtime, lowered).error
    assert isinstance(error, InternalError)
    assert "the explanation of run r1 is not possible" in error.message


def test_a_fault_of_the_explanation_leaves_the_check_of_the_calibration(
    runtime: WorkerRuntime, ring_board: RingBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert only(runtime, ring_board.conclusion()).error is None
    monkeypatch.setattr("vaoi_station.stitching.conclude.explanation", lambda _: 1 / 0)
    answer = only(runtime, CHECK).value
    assert isinstance(answer.document.error, InternalError)
    assert "the explanation of run r1 failed: ZeroDivisionError" in answer.document.error.message
    assert isinstance(answer.check.value, RunCheck)


def library_text(board: RingBoard) -> str:
    runner = TaskRunner(board.setup, lambda i, j: board.ring.frame(board.ring.slot(0, i, j)))
    evidence = [runner.perform(task) for task in board.tasks]
    return stitch_text(runner.conclude(board.head.row_times_s(), tuple(board.slots), evidence))


def test_a_check_equals_one_made_offline(runtime: WorkerRuntime, ring_board: RingBoard) -> None:
    only(runtime, ring_board.conclusion())
    assert runtime.reply(CloseRun("r1")) is None
    reply = only(runtime, CHECK).value.check
    assert reply is not None
    checked = reply.value
    assert isinstance(checked, RunCheck)
    assert checked == check_run("r1", WANTED.time, WANTED.board_type, ring_board.findings(), checked.lamps)
    assert [(lamp.camera, lamp.light) for lamp in checked.lamps] == [
        (i, ring_board.head.light(0) or "") for i in range(3)
    ]
    assert all(is_comparable(lamp) for lamp in checked.lamps)
    assert all(camera.links > 0 for camera in checked.cameras)


def test_a_job_that_fails_is_an_internal_error_and_one_of_a_later_board_is_gone(
    runtime: WorkerRuntime, ring_board: RingBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = dataclasses.replace(ring_board.context, generation=ring_board.context.generation + 1)
    assert isinstance(only(runtime, dataclasses.replace(ring_board.conclusion(), context=later)).error, GoneError)
    only(runtime, ring_board.conclusion())
    monkeypatch.setattr(module, "check_run", lambda *_: 1 // 0)
    reply = only(runtime, CHECK).value.check
    assert reply is not None
    error = reply.error
    assert isinstance(error, InternalError)
    assert "the calibration check of run r1 failed: ZeroDivisionError" in error.message
    for _ in range(2):
        assert runtime.reply(CloseRun("r1")) is None
    assert isinstance(only(runtime, ring_board.link(ring_board.tasks[0])).error, InternalError), "it was forgotten"


def render_jobs(runtime: WorkerRuntime, ring_board: RingBoard) -> list[RenderJob]:
    """Conclude the run; return a job for every view of its first component."""
    stitch = only(runtime, ring_board.conclusion()).value.without_components
    board_type, context = ring_board.setup.board_type, ring_board.context
    assert board_type is not None
    views = compute_views(board_type.components[0], board_type, stitch, ring_board.setup.cameras)
    return [
        RenderJob("r1", 0, context.generation, ring_board.slots[view.camera, view.row], view, "png") for view in views
    ]


def test_a_picture_from_a_recording_equals_that_from_the_ring(
    runtime: WorkerRuntime, ring_board: RingBoard, tmp_path: Path
) -> None:
    job = render_jobs(runtime, ring_board)[0]
    write_image(tmp_path / "frame.tiff", runtime._ring.frame(job.slot))
    kept = dataclasses.replace(job, generation=0, slot=0, file=tmp_path / "frame.tiff")
    assert only(runtime, kept).value == only(runtime, job).value
    (tmp_path / "frame.tiff").unlink()
    assert isinstance(only(runtime, kept).error, GoneError)

"""The work of one worker, without a process: jobs on a real ring with a board of the twin."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.runs.workers.conftest import CHECK, RingBoard
from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.lamps import is_comparable
from vaoi_station.errors import GoneError, InternalError
from vaoi_station.files.images import write_image
from vaoi_station.model import Status
from vaoi_station.rendering import compute_views
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.runs.workers import worker_runtime as module
from vaoi_station.runs.workers.jobs import (
    CloseRun,
    GatherJob,
    Job,
    Linked,
    Ping,
    RenderJob,
    Reply,
    WorkerReady,
)
from vaoi_station.runs.workers.worker_runtime import WorkerRuntime, encode
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.work import TaskRunner


@pytest.fixture
def runtime(ring_board: RingBoard) -> Iterator[WorkerRuntime]:
    with WorkerRuntime(str(ring_board.ring.path)) as made:
        assert list(made.replies(ring_board.opening)) == []
        yield made


@pytest.fixture(scope="session")
def linked(ring_board: RingBoard) -> dict[Task, Linked]:
    """The evidence of all tasks, found once."""
    with WorkerRuntime(str(ring_board.ring.path)) as other:
        list(other.replies(ring_board.opening))
        reply = only(other, ring_board.link(*ring_board.tasks))
    return dict(zip(ring_board.tasks, reply.value, strict=True))


def only(runtime: WorkerRuntime, job: Job) -> Reply:
    (reply,) = runtime.replies(job)
    assert isinstance(reply, Reply)
    return reply


def matrices(reply: Reply) -> Any:
    assert reply.error is None, reply.error
    return json.loads(reply.value.document)["image_matrices"]


def test_a_ping_is_answered_with_the_process_id(runtime: WorkerRuntime) -> None:
    (reply,) = runtime.replies(Ping())
    assert reply == runtime.ready()
    assert isinstance(reply, WorkerReady)


def test_links_are_those_of_a_task_runner(ring_board: RingBoard, linked: dict[Task, Linked]) -> None:
    task = ring_board.tasks[0]
    runner = TaskRunner(ring_board.setup, lambda i, j: ring_board.ring.frame(ring_board.slots[i, j]))
    expected = runner.perform(task)
    assert str(linked[task].evidence) == str(expected)
    assert linked[task].worker_s > 0


def test_a_result_does_not_depend_on_the_worker_that_found_the_evidence(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]
) -> None:
    half = len(ring_board.tasks) // 2
    mine, gathered = ring_board.tasks[:half], ring_board.tasks[half:]
    only(runtime, ring_board.link(*mine))
    assert only(runtime, GatherJob(ring_board.context, {t: linked[t] for t in gathered})).error is None
    split = matrices(only(runtime, ring_board.conclusion({})))
    with WorkerRuntime(str(ring_board.ring.path)) as other:
        list(other.replies(ring_board.opening))
        assert matrices(only(other, ring_board.conclusion(linked))) == split


def test_a_result_never_follows_from_less_evidence_than_there_is(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]
) -> None:
    """The transfer of three tasks' evidence has failed; the pool believes that the worker holds it."""
    job = ring_board.conclusion(linked).without(ring_board.tasks[:3])
    reply = only(runtime, job)
    assert reply.error is not None
    assert "the evidence of 3 tasks did not reach this worker" in reply.error.message
    assert only(runtime, ring_board.conclusion(linked)).error is None


def test_excluded_evidence_is_not_used(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]
) -> None:
    whole = only(runtime, ring_board.conclusion(linked))
    job = dataclasses.replace(ring_board.conclusion({}), excluded=frozenset(ring_board.tasks[:3]))
    assert matrices(only(runtime, job)) != matrices(whole)


def test_the_check_follows_the_result_and_equals_one_made_offline(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]
) -> None:
    replies = runtime.replies(ring_board.conclusion(linked, CHECK))
    result = next(replies)
    assert isinstance(result, Reply)
    (checked,) = replies
    assert isinstance(checked, Reply)
    assert isinstance(checked.value, RunCheck)
    lamps = checked.value.lamps
    assert checked.value == check_run("r1", CHECK.time, CHECK.board_type, ring_board.findings(linked), lamps)
    assert [(lamp.camera, lamp.light) for lamp in lamps] == [(i, ring_board.head.light(0) or "") for i in range(3)]
    assert all(is_comparable(lamp) for lamp in lamps)
    assert all(camera.links > 0 for camera in checked.value.cameras)


def test_a_failed_result_is_no_evidence_of_drift(runtime: WorkerRuntime, ring_board: RingBoard) -> None:
    job = dataclasses.replace(ring_board.conclusion({}, CHECK), excluded=frozenset(ring_board.tasks))
    (result,) = runtime.replies(job)
    assert isinstance(result, Reply)
    assert result.value.without_components.status is Status.FAILED


def test_the_check_starts_after_the_result_was_taken(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked], monkeypatch: pytest.MonkeyPatch
) -> None:
    checks: list[str] = []
    monkeypatch.setattr(module, "check_run", lambda run, *_: checks.append(run))
    replies = runtime.replies(ring_board.conclusion(linked, CHECK))
    next(replies)
    assert checks == []
    next(replies)
    assert checks == ["r1"]


def test_a_check_that_fails_leaves_the_result_alone(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> RunCheck:
        raise ZeroDivisionError("no cameras")

    monkeypatch.setattr(module, "check_run", fail)
    result, checked = runtime.replies(ring_board.conclusion(linked, CHECK))
    assert isinstance(result, Reply)
    assert isinstance(checked, Reply)
    assert result.error is None
    assert isinstance(checked.error, InternalError)
    assert "the calibration check of run r1 failed: ZeroDivisionError: no cameras" in checked.error.message


def test_frames_that_were_overwritten_give_no_brightness(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked], monkeypatch: pytest.MonkeyPatch
) -> None:
    replies = runtime.replies(ring_board.conclusion(linked, CHECK))
    next(replies)

    def gone(*_: Any) -> None:
        raise GoneError("a later run has this memory.")

    monkeypatch.setattr(module, "measure_lamps", gone)
    (checked,) = replies
    assert isinstance(checked, Reply)
    assert checked.value.lamps == ()
    assert checked.value.cameras


def test_a_failed_conclusion_has_no_check(runtime: WorkerRuntime, ring_board: RingBoard) -> None:
    later = dataclasses.replace(ring_board.context, generation=ring_board.context.generation + 1)
    job = dataclasses.replace(ring_board.conclusion({}, CHECK), context=later)
    assert isinstance(only(runtime, job).error, GoneError)


def test_a_check_alone_is_refused(runtime: WorkerRuntime) -> None:
    assert isinstance(only(runtime, CHECK).error, InternalError)


def test_a_closed_run_is_forgotten(runtime: WorkerRuntime, ring_board: RingBoard) -> None:
    assert list(runtime.replies(CloseRun("r1"))) == []
    assert list(runtime.replies(CloseRun("r1"))) == []
    error = only(runtime, ring_board.link(ring_board.tasks[0])).error
    assert isinstance(error, InternalError)
    assert "KeyError: 'r1'" in error.message


def render_jobs(runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]) -> list[RenderJob]:
    """Conclude the run; return a job for every view of its first component."""
    stitch = only(runtime, ring_board.conclusion(linked)).value.without_components
    board_type, context = ring_board.setup.board_type, ring_board.context
    assert board_type is not None
    views = compute_views(board_type.components[0], board_type, stitch, ring_board.setup.cameras)
    return [
        RenderJob("r1", 0, context.generation, ring_board.slots[view.camera, view.row], view, "png") for view in views
    ]


def test_a_picture_is_rendered_from_its_slot(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]
) -> None:
    job = render_jobs(runtime, ring_board, linked)[0]
    assert decoded(only(runtime, job).value).shape[:2] == (job.view.height, job.view.width)
    stale = dataclasses.replace(job, generation=job.generation + 1)
    assert isinstance(only(runtime, stale).error, GoneError)


def test_a_picture_from_a_recording_equals_that_from_the_ring(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked], tmp_path: Path
) -> None:
    job = render_jobs(runtime, ring_board, linked)[0]
    write_image(tmp_path / "frame.tiff", runtime._ring.frame(job.slot))
    kept = dataclasses.replace(job, generation=0, slot=0, file=tmp_path / "frame.tiff")
    assert only(runtime, kept).value == only(runtime, job).value
    (tmp_path / "frame.tiff").unlink()
    assert isinstance(only(runtime, kept).error, GoneError)


def test_a_difference_is_made_from_two_slots(
    runtime: WorkerRuntime, ring_board: RingBoard, linked: dict[Task, Linked]
) -> None:
    a, b = render_jobs(runtime, ring_board, linked)[:2]
    same = dataclasses.replace(a, minus=a)
    assert (decoded(only(runtime, same).value) == 128).all()
    pictures = [decoded(only(runtime, job).value).astype(float) for job in (a, b)]
    halved = decoded(only(runtime, dataclasses.replace(a, minus=b, ratio=0.5)).value)
    assert np.abs(halved - (128 + (pictures[0] - 0.5 * pictures[1]) / 2)).max() <= 0.5


def decoded(content: bytes) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize("format", ["png", "tiff", "npy"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_lossless_formats_keep_every_pixel(format: ImageFormat, dtype: type) -> None:
    image: NDArray[Any] = np.arange(35, dtype=dtype).reshape(5, 7) * 3
    content = encode(image, format)
    back = np.load(io.BytesIO(content)) if format == "npy" else decoded(content)
    assert back.dtype == dtype
    assert np.array_equal(back, image)


def test_jpeg_is_close_to_the_picture() -> None:
    image = np.full((64, 64), 120, np.uint8)
    back = decoded(encode(image, "jpeg"))
    assert np.abs(back.astype(int) - image).max() <= 2


def test_a_missing_ring_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="ring"):
        WorkerRuntime(str(tmp_path / "ring"))


def test_colours_of_npy_are_red_green_blue() -> None:
    blue = np.zeros((2, 3, 3), np.uint8)
    blue[..., 0] = 9  # OpenCV's first channel
    assert np.load(io.BytesIO(encode(blue, "npy")))[0, 0].tolist() == [0, 0, 9]

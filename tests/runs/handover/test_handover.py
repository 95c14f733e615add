"""Runs go to the archive when the line leaves time, and wait for an archive that is absent."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import Pipe
from pathlib import Path
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from tests.runs.conftest import a_board_type, a_stitch
from vaoi_station.acquisition.process.messages import Grant
from vaoi_station.backoff import BackoffPolicy
from vaoi_station.config import ArchiveConfig
from vaoi_station.files import open_recording, write_board_type
from vaoi_station.identity.code_reader import Progress
from vaoi_station.model import BoardCode, BoardIdentity, BoardReading, Status
from vaoi_station.plant.archive import Archive
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.recordings import Recordings
from vaoi_station.runs.handover import handover as module
from vaoi_station.runs.handover.adder import serve
from vaoi_station.runs.handover.handover import Handover
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.runs.workers.jobs import Reply
from vaoi_station.runs.workers.picture_jobs import IdentityJob, IdentitySlice


class Helper(threading.Thread):
    """The adder as a thread of the test: no process starts."""

    def kill(self) -> None:
        """Do nothing: it ends because its pipe is closed."""

    def wait(self, timeout: float) -> None:
        """Wait for its end."""
        self.join(timeout)

    def poll(self) -> int | None:
        """Return None while it runs."""
        return None if self.is_alive() else 0


class Blocked(Helper):
    """An adder that does not end when it is killed."""

    def wait(self, timeout: float) -> None:
        """Return at once: no caller may wait for it."""
        raise subprocess.TimeoutExpired("adder", timeout)


def launch() -> tuple[Any, Helper]:
    """Start an adder."""
    ours, its = Pipe()
    helper = Helper(target=serve, args=(its,))
    helper.start()
    return ours, helper


class Line:
    """A station, an archive, and the thread between them."""

    def __init__(self, rig: Any, folder: Path) -> None:
        self.rig, self.folder = rig, folder
        self.busy = threading.Event()
        self.armed = False
        self.codes: list[str] = []
        self.recordings = rig.coordinator.kept.recordings

    def add(self, _kind: str, _message: str, code: str = "", **_: object) -> None:
        """Take an event of the thread."""
        self.codes.append(code)

    @contextmanager
    def running(self, **settings: Any) -> Iterator[Handover]:
        """Hand over to the archive in `folder`."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "launch_adder", settings.pop("launch", launch))
            patch.setattr(module, "SILENCE_S", settings.pop("silence_s", module.SILENCE_S))
            patch.setattr(module, "RETRY", BackoffPolicy(first_s=0.01, longest_s=0.02, proven_s=60.0))
            config = ArchiveConfig(url=str(self.folder), **settings)
            made = Handover(config, "one", cast("EventLog", self), self.busy.is_set)
            with made.running(self.recordings):
                yield made

    def board(self, verdict: Status, **options: Any) -> RunDetail:
        """Film a board."""
        self.rig.workers.result = lambda head: a_stitch(head, verdict, ("weak",) if verdict is not Status.OK else ())
        # The line stays armed: the grant for the next board comes by itself.
        grant = self.rig.peer.expect(Grant) if self.armed else self.rig.arm(**options)
        self.armed = True
        self.rig.board(grant)
        detail: RunDetail = self.rig.result_of(grant.run)
        return detail

    def wait(self, true: Callable[[], bool], what: str) -> None:
        """Wait until a condition holds."""
        self.rig.wait_for(true, what)


@pytest.fixture
def line(make_rig: Callable[..., Any], tmp_path: Path) -> Line:
    """Return a station that is ready, and the path of an archive that is not made yet."""
    rig = make_rig()
    rig.ready()
    return Line(rig, tmp_path / "archive")


def test_a_degraded_run_is_archived_and_stays_as_a_recording(line: Line, tmp_path: Path) -> None:
    archive = Archive.create(line.folder)
    with line.running() as handover:
        run = line.board(Status.DEGRADED)
        line.wait(lambda: handover.status().added == 1, "the run is in the archive")
    [added] = archive.runs()
    assert (added.run, added.station, added.time, added.verdict) == (run.id, "one", run.started, "degraded")
    assert archive.verify().faults == 0
    kept = open_recording(line.recordings.directory / run.id)
    back = open_recording(archive.extract(run.id, tmp_path / "back"))
    assert np.array_equal(back.frame(1, 2), kept.frame(1, 2))  # type: ignore[arg-type]
    assert line.codes == []


@contextmanager
def restarted(line: Line) -> Iterator[None]:
    """Give the line the recordings of a station after a restart."""
    before = line.recordings
    made = Recordings(before.directory, before._keep, before._archive, before._events, Mock())
    line.recordings = made
    made.start()
    yield
    made.stop()


def test_a_restart_forgets_no_run_that_is_recorded_for_the_archive_only(line: Line) -> None:
    with line.running(ok_every=1) as handover:
        runs = [line.board(Status.OK).id for _ in range(2)]
        line.wait(lambda: handover.status().waiting == 2, "both wait for an archive that is absent")
    line.rig.coordinator.kept.pin(runs[0])
    line.wait(lambda: runs[0] not in line.recordings._for_archive, "the pinned one is kept beyond the archive")
    Archive.create(line.folder)
    with restarted(line), line.running(ok_every=1) as handover:
        line.wait(lambda: handover.status().added == 2, "both are in the archive")
        line.wait(lambda: line.recordings.path_of(runs[1]) is None, "the recording of the other is deleted")
    assert line.recordings.all() == (runs[0],)
    assert not (line.recordings.directory / runs[1]).exists()


def record_of(line: Line, run: str) -> dict[str, Any]:
    """Return run.json of a recording."""
    found: dict[str, Any] = json.loads((line.recordings.directory / run / "run.json").read_text())
    return found


def test_a_run_is_handed_over_with_the_verdict_that_its_identity_leaves(line: Line) -> None:
    identity = BoardIdentity(pattern="b;{id}", required=True)
    write_board_type(
        line.rig.config.board_types / "small.json", a_board_type().model_copy(update={"identity": identity})
    )
    held: list[IdentityJob] = []
    perform = line.rig.workers.perform
    line.rig.workers.perform = lambda job: held.append(job) if isinstance(job, IdentityJob) else perform(job)
    archive = Archive.create(line.folder)
    with line.running(ok_every=1) as handover:
        run = line.board(Status.OK, board_id="S1")
        line.wait(lambda: line.recordings.path_of(run.id) is not None and bool(held), "the run is recorded")
        pending = (line.recordings.directory / run.id / "run.json").read_bytes()
        assert json.loads(pending)["identity"]["state"] == "pending"
        assert handover.status().waiting == 0, "its verdict is not known yet"
        code = BoardCode(
            text="b;S2", symbology="qr", board_id="S2", center=(0, 0), corners=((0, 0),) * 4, module_mm=0.2,
            error_correction_used=0.0,
        )  # fmt: skip
        read = IdentitySlice(Progress((), 1, True), BoardReading(codes=(code,)), 0.1)
        line.rig.workers.answer(held[0], Reply(read, None, 0.1))
        line.wait(lambda: handover.status().added == 1, "the run is in the archive")
    [added] = archive.runs()
    assert (added.verdict, added.serial) == ("degraded", "S2")
    assert record_of(line, run.id)["verdict"] == "degraded"
    # The station ended after the identity was decided, and before the recording had it.
    (line.recordings.directory / run.id / "run.json").write_bytes(pending)
    with restarted(line), line.running(ok_every=1) as handover:
        line.wait(lambda: handover.status().added == 1, "the run is added again")
    assert record_of(line, run.id)["verdict"] == "degraded"
    assert list(archive.runs()) == [added]
    assert line.codes == []


def test_runs_wait_for_an_absent_archive_and_the_station_says_so(line: Line) -> None:
    with line.running() as handover:
        run = line.board(Status.FAILED)
        line.wait(lambda: handover.reasons() != (), "the warning")
        [warning] = handover.reasons()
        assert warning.code == "archive-waits"
        assert "is no archive" in warning.message
        assert "1 runs wait on this disk" in warning.message
        assert "mounted" in warning.action
        Archive.create(line.folder)
        line.wait(lambda: handover.status().added == 1, "the run is in the archive")
        assert (handover.reasons(), handover.status().waiting) == ((), 0)
    assert line.codes == ["archive-waits", "archive-back"]
    assert Archive.open(line.folder).run(run.id).verdict == "failed"


def test_runs_that_the_archive_has_make_room_before_one_that_waits_for_it(line: Line) -> None:
    """Also if they came later: here the identity of the first one is read last."""
    Archive.create(line.folder)
    with line.running() as handover:
        waits, has = line.board(Status.FAILED), line.board(Status.FAILED)
        line.wait(lambda: handover.status().added == 2, "the runs are in the archive")
        shutil.rmtree(line.folder)
        handover.offer(waits.id)
        line.wait(lambda: handover.status().problem != "", "the archive is absent")
        assert line.recordings._drop_oldest()
        assert line.recordings.all() == (waits.id,)
    assert has.id > waits.id


def test_nothing_is_written_while_a_board_is_filmed(line: Line) -> None:
    archive = Archive.create(line.folder)
    line.busy.set()
    with line.running() as handover:
        run = line.board(Status.FAILED)
        line.wait(lambda: handover.status().adding == run.id, "the run has its turn")
        assert list(archive.storage.entries("blobs")) == []
        line.busy.clear()
        line.wait(lambda: handover.status().added == 1, "the run is in the archive")


def test_a_station_that_stops_gives_a_run_up_and_goes_on_after_its_start(line: Line) -> None:
    archive = Archive.create(line.folder)
    line.busy.set()
    with line.running() as handover:
        run = line.board(Status.FAILED)
        line.wait(lambda: handover.status().adding == run.id, "the run has its turn")
    assert not handover.thread.is_alive()
    line.busy.clear()
    with line.running() as again:
        line.wait(lambda: again.status().added == 1, "the run is in the archive")
    assert [one.run for one in archive.runs()] == [run.id]


def test_a_run_that_cannot_be_added_is_named_and_others_are_added(line: Line) -> None:
    archive = Archive.create(line.folder)
    line.busy.set()
    with line.running() as handover:
        run = line.board(Status.FAILED)
        line.wait(lambda: handover.status().adding == run.id, "the run has its turn")
        frame = line.recordings.directory / run.id / "frames" / "c01_r002.tiff"
        content = frame.read_bytes()
        frame.write_text("torn")
        line.busy.clear()
        line.wait(lambda: handover.status().refused == 1, "the run is refused")
        frame.write_bytes(content)
        handover.offer(run.id)
        line.wait(lambda: handover.status().added == 1, "it is in the archive")
    assert line.codes == ["archive-refused"]
    assert [one.run for one in archive.runs()] == [run.id]


def test_an_adder_that_a_share_blocks_is_given_up_and_no_other_is_blocked(line: Line) -> None:
    Archive.create(line.folder)
    answers, started = threading.Event(), []

    def launch_blocked() -> tuple[Any, Helper]:
        if answers.is_set():
            return launch()
        ours, its = Pipe()
        started.append(its)
        helper = Blocked(target=answers.wait, daemon=True)
        helper.start()
        return ours, helper

    with line.running(launch=launch_blocked, silence_s=0.3) as handover:
        line.board(Status.FAILED)
        line.wait(lambda: handover.reasons() != (), "the warning")
        assert "does not answer" in handover.reasons()[0].message
        answers.set()
        line.wait(lambda: handover.status().added == 1, "the run is in the archive")
    assert len(started) == 1
    assert line.codes == ["archive-waits", "archive-back"]

"""Identities of finished runs: read after the result, stored, compared, and shown in the documents of runs."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from tests.runs.finished import held_run
from vaoi_station.errors import StateError
from vaoi_station.identity.code_reader import Progress
from vaoi_station.identity.comparison import compare
from vaoi_station.model import BoardCode, BoardIdentity, BoardReading, BoardType, Status
from vaoi_station.model.board_identity import IdentityDocument, ReportedId
from vaoi_station.runs.archive.read_identities import ReadIdentities
from vaoi_station.runs.archive.stored_documents import identity_row
from vaoi_station.runs.run.verdict import RunVerdict, identified
from vaoi_station.runs.states.schemas import IdentitySummary, RunSummary, VerdictCounts
from vaoi_station.runs.states.tables import RunState
from vaoi_station.runs.workers.jobs import Priority
from vaoi_station.runs.workers.picture_jobs import IdentitySlice
from vaoi_station.store.documents import IdentityRow

CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
IDENTITY = BoardIdentity(pattern="b;{id}", required=True)


def reading(text: str) -> BoardReading:
    code = BoardCode(
        text=text, symbology="qr", board_id=IDENTITY.board_id(text), center=(0.5, 0.5), corners=CORNERS,
        module_mm=0.2, error_correction_used=0.0,
    )  # fmt: skip
    return BoardReading(codes=(code,), complete=False)


class Station:
    """Holds runs; the worker needs two slices for each and reads the code `b;1`."""

    def __init__(self, identity: BoardIdentity | None = IDENTITY) -> None:
        self.jobs: list[Any] = []
        self.saved: dict[str, IdentityRow] = {}
        self.events: list[dict[str, Any]] = []
        self.done, self.free = threading.Event(), threading.Event()
        self.free.set()
        self.fault: Exception | None = None
        self.worker_s = 0.1
        frames = tuple(SimpleNamespace(camera=0, row=j, slot=j, usable=j != 1) for j in range(3))
        board_type = BoardType(name="b", outline=((0, 0), (9, 9)), identity=identity)
        pending = None if identity is None else compare(identity, None, "1", without="pending")
        self.finished = held_run(
            detail=SimpleNamespace(id="r1", frames=frames, board_id="1", stored=True, skipped_boards=()),
            board_type=board_type,
            cameras=(),
            stitch=SimpleNamespace(cad_matrix=[[1.0]]),
            identity=pending,
        )
        self.finished.detail.identity = self.finished.identity and IdentitySummary.of(self.finished.identity)
        archive: Any = SimpleNamespace(get=self.get, identities=self, identify=self.identify)
        events: Any = self
        self.identities = ReadIdentities(archive, self.render, self.bay_of, events)

    def get(self, run: str) -> Any:
        return self.finished

    def pending(self) -> list[str]:
        return [run for run, row in self.saved.items() if row.pending]

    def identify(self, run: str, identity: IdentityDocument) -> Future[None]:
        self.saved[run] = identity_row(identity)
        self.finished.identity = identity
        done: Future[None] = Future()
        done.set_result(None)
        return done

    def bay_of(self, run: str) -> Any:
        return SimpleNamespace(number=4, generation=2)

    def render(self, job: Any, name: str) -> Any:
        self.jobs.append(job)
        assert self.free.wait(20)
        if self.fault is not None:
            raise self.fault
        return IdentitySlice(
            Progress((), job.progress.next_try + 1, job.progress.next_try > 0), reading("b;1"), self.worker_s
        )

    def add(self, kind: str, message: str, **fields: Any) -> None:
        self.events.append({"kind": kind, "message": message, **fields})
        self.done.set()

    def read(self) -> None:
        """Let the run end, and wait until its identity is published."""
        self.identities.start()
        self.identities.finished(self.finished.detail)
        assert self.done.wait(20)
        self.identities.queue.stop()
        assert self.identities.queue.thread.fault() is None

    def shown(self, verdict: Status = Status.OK) -> RunSummary:
        summary = RunSummary(
            id="r1", board_type="b", board_id="1", job_id=None, state=RunState.READY, verdict=verdict, started="",
            finished="", rows=3, cameras=1, counts=VerdictCounts(ok=3, incomplete=0, missing=0), reasons=(), belt=None,
            timings=None, frames_available=True,
        )  # fmt: skip
        return identified(summary, RunVerdict(verdict, ()), self.finished.identity)


def test_codes_are_read_in_slices_of_their_own_priority_and_stored() -> None:
    station = Station()
    station.read()
    assert [job.progress.next_try for job in station.jobs] == [0, 1]
    assert {job.priority for job in station.jobs} == {Priority.IDENTITY}
    assert station.jobs[0].slots == {(0, 0): 0, (0, 2): 2}
    found = station.identities.document("r1")
    assert (found.state, found.board_id, found.armed_board_id) == ("agrees", "1", "1")
    assert list(station.saved["r1"].board_ids) == ["1"]
    assert [(e["kind"], e["state"], e["code"]) for e in station.events] == [("identity", "agrees", "")]
    shown = station.shown()
    assert shown.identity is not None
    assert (shown.identity.state, shown.verdict) == ("agrees", Status.OK)


def test_another_id_degrades_a_run_whose_type_demands_it() -> None:
    station = Station()
    station.finished.detail.board_id = "2"
    station.read()
    shown = station.shown()
    assert (shown.verdict, shown.state) == (Status.DEGRADED, RunState.DEGRADED)
    assert [r.code for r in shown.reasons] == ["board-id-differs"]
    assert shown.board_id == "1", "no id replaces another"
    assert station.events[0]["code"] == "board-id-differs"
    easy = Station(IDENTITY.model_copy(update={"required": False}))
    easy.finished.detail.board_id = "2"
    easy.read()
    assert easy.shown().verdict is Status.OK


def test_run_is_pending_until_its_codes_are_read() -> None:
    station = Station()
    station.free.clear()
    station.identities.start()
    station.identities.finished(station.finished.detail)
    try:
        assert station.identities.document("r1").state == "pending"
        pending = station.shown()
        assert pending.identity is not None
        assert (pending.identity.state, pending.verdict) == ("pending", Status.OK)
        with pytest.raises(StateError) as refused:
            station.identities.report("r1", ReportedId(board_id="1"))
        assert refused.value.code == "identity-pending"
    finally:
        station.free.set()
    assert station.done.wait(20)
    station.identities.queue.stop()
    assert station.identities.document("r1").state == "agrees"


def test_run_whose_codes_were_being_read_when_the_station_ended_is_degraded() -> None:
    again = Station()
    again.saved["r1"] = identity_row(again.finished.identity)
    degraded: list[str] = []
    again.identities.on_changed = degraded.append
    again.identities.start()
    assert again.done.wait(20)
    again.identities.queue.stop()
    shown = again.shown()
    assert (shown.verdict, [r.code for r in shown.reasons]) == (Status.DEGRADED, ["identity-not-read"])
    assert (again.pending(), degraded, again.jobs) == ([], ["r1"], [])

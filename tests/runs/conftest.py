"""A coordinator on a small ring, with a scripted acquisition process and scripted workers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.runs.peer import PATIENCE_S, Peer, end_link
from vaoi_station.acquisition.pairing.proof import TriggerProof, doubts_of
from vaoi_station.acquisition.pairing.run_record import Interruption
from vaoi_station.acquisition.process import messages
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import CameraConfig, KeepConfig, ReplayConfig, RingConfig, StationConfig
from vaoi_station.drift.checks import CameraCheck, RunCheck
from vaoi_station.errors import NotFoundError
from vaoi_station.files import write_board_type
from vaoi_station.files.results import stitch_text, without_components
from vaoi_station.line_config import Line, Smema
from vaoi_station.model import (
    BoardType,
    Calibration,
    CameraHead,
    Component,
    Fiducial,
    FrameRecord,
    Pulse,
    RecordingHead,
    Status,
    Stitch,
    Verdict,
)
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import acquisition_link
from vaoi_station.runs.control.acquisition_link import AcquisitionLink
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.control.core import Parts
from vaoi_station.runs.run.memory import Bay, BayGrants
from vaoi_station.runs.run.order import OrderFactory
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.workers.jobs import (
    Concluded,
    ConcludeJob,
    Explained,
    ExplainJob,
    Job,
    LinkJob,
    OpenRun,
    Reply,
    WantedCheck,
)
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.store import BoardTypeDirectory, Database, Store

WIDTH, HEIGHT, PX_PER_MM = 64, 48, 2.0
PERIOD_S, SPEED_MM_S = 0.1, 100.0
Done = Callable[[Reply], object]


def a_board_type() -> BoardType:
    return BoardType(
        name="small",
        outline=((0, 0), (40, 30)),
        fiducials=(Fiducial(name="F1", x=5, y=5, diameter=1), Fiducial(name="F2", x=35, y=25, diameter=1)),
        components=(Component(ref="U1", center=(10, 10), width=4, height=4),),
    )


def a_calibration(cameras: int = 2) -> Calibration:
    matrices = [[[PX_PER_MM, 0, -30 * i * PX_PER_MM], [0, PX_PER_MM, 0], [0, 0, 1]] for i in range(cameras)]
    return Calibration.model_validate(
        {"format": "vaoi-calibration", "version": 1, "unit": "mm", "camera_matrices": matrices}
    )


def a_config(
    directory: Path,
    runs: int = 3,
    cameras: int = 2,
    keep_s: float = 0.0,
    lock: str = "off",
    name: str = "test",
    smema: Smema | None = None,
) -> StationConfig:
    (directory / "ring").mkdir(exist_ok=True)
    config = StationConfig(
        name=name,
        calibration=directory / "calibration.json",
        board_types=directory / "board-types",
        data=directory / "data",
        workers=2,
        line=Line(
            conveyor_mm_s=(0.0, SPEED_MM_S), barrier_mm=0.0, start_delay_s=0.0,
            trigger_period_s=PERIOD_S, tail_s=0.0, longest_board_mm=50.0,
        ),
        cameras=tuple(
            CameraConfig(name=f"c{i}", backend="replay", width=WIDTH, height=HEIGHT, exposure_us=100.0)
            for i in range(cameras)
        ),
        controller={"backend": "replay"}, replay=ReplayConfig(recordings=(directory,)),
        # 0 is shorter than station.toml allows: boards of a test follow one another within milliseconds.
        ring=RingConfig(directory=directory / "ring", runs=runs).model_copy(update={"keep_s": keep_s}),
        keep=KeepConfig(mosaics_gb=0.0),  # the workers of these tests render nothing
    )  # fmt: skip
    controller = config.controller.model_copy(update={"interlock": lock})
    return config.model_copy(update={"controller": controller, "smema": smema})


def a_head(rows: int, missing: tuple[tuple[int, int], ...] = ()) -> RecordingHead:
    return RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=tuple(CameraHead(width=WIDTH, height=HEIGHT, exposure_us=100) for _ in range(2)),
        rows=rows,
        trigger_period_s=PERIOD_S,
        conveyor_mm_s=(0.0, SPEED_MM_S),
        missing=missing,
    )


def a_stitch(head: RecordingHead, status: Status = Status.OK, reasons: tuple[str, ...] = ()) -> Stitch:
    """Return what a perfect stitch of the small rig would be."""
    rows = [np.array([[1, 0, 0], [0, 1, 1.01 * SPEED_MM_S * t], [0, 0, 1.0]]) for t in head.row_times_s()]
    cameras = a_calibration(len(head.cameras)).camera_matrices
    return Stitch(
        method="auto",
        image_matrices=tuple(tuple(n @ d for d in rows) for n in cameras),
        cad_matrix=np.array([[1, 0, 0], [0, -1, 30.0], [0, 0, 1]]),
        row_motion=tuple(rows),
        status=status,
        reasons=reasons,
        quality={"cad_sigma_px": 0.02},
    )


def explained(stitch: Stitch) -> Stitch:
    """Return a result with empty tables in place of those that it names as coming later."""
    later: dict[str, Any] = {key: {} for key in stitch.quality.get("later", ())}
    kept = {key: value for key, value in stitch.quality.items() if key != "later"}
    return stitch.model_copy(update={"quality": {**kept, **later}})


@dataclass
class ScriptedWorkers:
    """Performs jobs at once, or when the test asks for it if `keep` is set; concludes with `result`."""

    keep: bool = False
    kept: list[Job] = field(default_factory=list)
    done: list[Job] = field(default_factory=list)
    opened: list[OpenRun] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    result: Callable[[RecordingHead], Stitch] = a_stitch
    displacement_px: float = 0.0
    """By which camera 1 shows itself displaced along y."""
    answered: dict[str, Stitch] = field(default_factory=dict)
    """The results as they were answered, by run."""
    receivers: dict[int, Done] = field(default_factory=dict)
    """What gets the reply of a job, by the identity of the job: two may be equal."""

    def submit(self, job: Job, done: Done) -> None:
        self.receivers[id(job)] = done
        if self.keep:
            self.kept.append(job)
        else:
            self.perform(job)

    def answer(self, job: Job, reply: Reply) -> None:
        self.receivers[id(job)](reply)

    def perform(self, job: Job) -> None:
        self.done.append(job)
        match job:
            case LinkJob():
                self.answer(job, Reply((0.001,) * len(job.tasks), None, 0.001))
            case ConcludeJob():
                stitch = self.result(job.head)
                self.answered[job.run] = stitch
                self.answer(job, Reply(Concluded(without_components(stitch), stitch_text(stitch)), None, 0.002))
            case ExplainJob():
                verdict = {"status": job.status, "reasons": job.reasons, "reason_codes": job.reason_codes}
                document = stitch_text(explained(self.answered[job.run]).model_copy(update=verdict))
                check = None if job.check is None else self.check_reply(job.check)
                self.answer(job, Reply(Explained(Reply(document, None, 0.0), check), None, 0.003))
            case _:
                self.answer(job, Reply(b"picture", None, 0.001))

    def check_reply(self, job: WantedCheck) -> Reply:
        return Reply(self.check(job.run), None, 0.003)

    def check(self, run: str) -> RunCheck:
        """Camera 0 as it was calibrated, camera 1 displaced."""
        rest: dict[str, Any] = {"sigma_px": (0.02,) * 3, "left_px": 0.1, "links": 50, "fiducials": 2}
        cameras = [CameraCheck(x_px=0.0, y_px=y, turn_px=0.0, rms_px=y, **rest) for y in (0.0, self.displacement_px)]
        return RunCheck(
            run=run, time="2026-01-01T00:00:00Z", board_type="b", cameras=tuple(cameras), rivals=(),
            information=tuple(2500.0 * np.eye(6)[np.tril_indices(6)]),
            vector=(0.0, 0.0, 0.0, 0.0, 2500.0 * self.displacement_px, 0.0),
        )  # fmt: skip

    def perform_kept(self) -> None:
        self.keep = False
        for job in self.kept:
            self.perform(job)
        self.kept.clear()

    def open_run(self, opening: OpenRun) -> None:
        self.opened.append(opening)

    def close_run(self, run: str) -> None:
        self.closed.append(run)

    def hastened(self, kind: object, run: str) -> nullcontext[None]:
        return nullcontext()

    def tasks(self, run: str) -> list[Task]:
        return [task for job in self.done if isinstance(job, LinkJob) and job.run == run for task in job.tasks]


@dataclass
class Rig:
    """A coordinator with its parts."""

    config: StationConfig
    coordinator: StationCoordinator
    ring: Ring
    peer: Peer
    workers: ScriptedWorkers
    link: AcquisitionLink
    store: Store
    archive: Archive

    def ready(self) -> None:
        self.peer.wait_for_start(1)
        self.peer.report(messages.Ready(2))
        self.until("idle")

    def until(self, state: str) -> None:
        """Wait for a state of the station; every change is an event."""
        self.wait_for(lambda: self.coordinator.snapshot().state == state, f"the station to be {state}")

    def wait_for(self, true: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
        deadline, seen = time.monotonic() + patience_s, 0
        while not true():
            assert time.monotonic() < deadline, f"waited for {what}: {self.coordinator.snapshot()}"
            records = self.coordinator.events(seen, 0.2)
            seen = records[-1].number if records else seen

    def wait_run(self, run: str, true: Callable[[Any], bool], what: str) -> None:
        """Wait for something about a run that may not have begun yet."""

        def met() -> bool:
            try:
                return true(self.coordinator.run(run))
            except NotFoundError:
                return False

        self.wait_for(met, what)

    def arm(self, **options: Any) -> messages.Grant:
        """Arm, playing the other side; the grant that came with it."""
        with ThreadPoolExecutor(1) as caller:
            outcome = caller.submit(self.coordinator.arm, "small", **options)
            grant = self.peer.expect(messages.Grant)
            self.peer.expect(messages.Arm)
            self.peer.report(messages.Armed())
            outcome.result(PATIENCE_S)
        return grant

    def begin(self, grant: messages.Grant, at_s: float | None = None) -> float:
        """Report that a board has interrupted the barrier."""
        at_s = time.monotonic() if at_s is None else at_s
        self.peer.report(messages.RunStarted(grant.run, grant.bay, at_s))
        return at_s

    def row(self, grant: messages.Grant, row: int, verdicts: dict[int, Verdict] | None = None) -> list[FrameRecord]:
        """One pulse, and a frame per camera filled with its number."""
        self.peer.report(messages.PulseReported(grant.run, Pulse(index=row, time_s=100 + row * PERIOD_S)))
        records = []
        for camera in range(2):
            verdict = (verdicts or {}).get(camera, Verdict.OK)
            slot = None if verdict is Verdict.MISSING else self.ring.slot(grant.bay, camera, row)
            if slot is not None:
                self.ring.memory(slot)[:] = 10 + 20 * camera + row
            cause = "" if verdict is Verdict.OK else "scripted"
            records.append(FrameRecord(camera=camera, row=row, verdict=verdict, cause=cause, slot=slot))
            self.peer.report(messages.FrameSettled(grant.run, records[-1], time.monotonic()))
        return records

    def finish(
        self,
        grant: messages.Grant,
        records: list[FrameRecord],
        reason: str = "clear",
        proof: TriggerProof | None = None,
        interruptions: tuple[Interruption, ...] = (),
    ) -> None:
        """Every frame has its verdict."""
        rows = 1 + max(r.row for r in records)
        missing = tuple((r.camera, r.row) for r in records if not r.usable)
        head = a_head(rows, missing).model_copy(update={"doubts": doubts_of(proof)})
        ordered = tuple(sorted(records, key=lambda r: (r.camera, r.row)))
        self.peer.report(
            messages.RunFinished(
                grant.run, grant.bay, head, ordered, time.monotonic(), reason, proof=proof, interruptions=interruptions
            )
        )

    def board(self, grant: messages.Grant, rows: int = 3, verdicts: dict[int, Verdict] | None = None) -> None:
        """Report one complete passage."""
        self.begin(grant)
        records = [r for row in range(rows) for r in self.row(grant, row, verdicts if row == 1 else None)]
        self.finish(grant, records)

    def result_of(self, run: str) -> Any:
        self.wait_for(lambda: (latest := self.coordinator.latest()) is not None and latest.id >= run, f"{run} to end")
        return self.coordinator.run(run)


@pytest.fixture(autouse=True)
def _silent_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no scripted process, which sends no heartbeats, be killed for its silence on a slow machine."""
    monkeypatch.setattr(acquisition_link, "HEARTBEAT_LIMIT_S", 600.0)


@pytest.fixture
def peer() -> Peer:
    return Peer()


@pytest.fixture
def board_type() -> BoardType:
    return a_board_type()


@pytest.fixture
def calibration() -> Calibration:
    return a_calibration()


@pytest.fixture
def config(tmp_path: Path) -> StationConfig:
    return a_config(tmp_path)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = Store(Database(tmp_path / "data" / "station.db"))
    yield opened
    opened.close()


@pytest.fixture
def make_stitch() -> Callable[..., Stitch]:
    return a_stitch


@pytest.fixture
def make_head() -> Callable[[int], RecordingHead]:
    return a_head


@pytest.fixture
def make_rig(tmp_path: Path, store: Store) -> Iterator[Callable[..., Rig]]:
    """Build rigs; whatever happens, their threads end and their ring is unlinked."""
    ends: list[Callable[[], object]] = []

    def make(**options: Any) -> Rig:
        config = a_config(tmp_path, **options)
        write_board_type(config.board_types / "small.json", a_board_type())
        ring = Ring.create(ring_path(config), RingLayout.of(config))
        ends.append(ring.close)
        shelf = ReferenceStore(config.data / "references", store, a_calibration().cameras(config.heads))
        events = EventLog(store)
        archive, peer, workers = Archive(store, events), Peer(), ScriptedWorkers()
        link = AcquisitionLink(peer.launch)
        grants = BayGrants(ring.blacken, link)
        watch = CalibrationWatch(store.checks, events, a_calibration(), [c.name for c in config.cameras])
        coordinator = StationCoordinator(
            Parts(config, ring.renew, grants, workers, archive, events, RunIds(store.newest_run()), watch),
            ring,
            BoardTypeDirectory(config.board_types),
            OrderFactory(config, a_calibration(), store, shelf),
            shelf,
            lambda: (link.status(),),
        )
        ends.append(coordinator.close)
        coordinator.start()
        ends.append(grants.stop)
        grants.start()
        ends.append(lambda: end_link(link, peer))
        link.start(coordinator.acquisition_message, coordinator.acquisition_ended)
        return Rig(config, coordinator, ring, peer, workers, link, store, archive)

    yield make
    for end in reversed(ends):
        end()


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    made: Rig = make_rig()
    made.ready()
    return made


@pytest.fixture
def progress(config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType) -> Progress:
    """Return a run r1 in bay 1 whose board has just interrupted the barrier, at 50 s."""
    references = ReferenceStore(config.data / "references", store, calibration.cameras(config.heads))
    order = OrderFactory(config, calibration, store, references)(board_type, None, None)
    return Progress.begin(messages.RunStarted("r1", 1, 50.0), Bay(1, "filming", "r1", 7), order)

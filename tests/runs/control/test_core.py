"""The decisions of the coordinator's thread, called directly: messages, answers of stitchers, releases and the stop."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from tests.runs.conftest import a_head, a_stitch, explained
from tests.runs.doubles import Acquisition, CountingRing, Workers
from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.process import messages
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InternalError, StateError
from vaoi_station.files.results import stitch_text, without_components
from vaoi_station.model import Calibration, FrameRecord, Pulse, Status, Verdict
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.camera_places import CameraPlaces
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.line_control import Completion
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.progress import CAUSE, Progress
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.workers.jobs import Concluded, ConcludeJob, Explained, ExplainJob, LinkJob, Reply
from vaoi_station.store import Store


class Station:
    """A core on doubles; `events` are the messages published so far."""

    def __init__(self, config: StationConfig, store: Store, calibration: Calibration, order: Order) -> None:
        self.log = EventLog(store)
        self.acquisition, self.workers, self.order = Acquisition(), Workers(), order
        self.archive = Archive(store, self.log)
        watch = CalibrationWatch(store.checks, self.log, calibration, ["left", "right"])
        renew = CountingRing().renew
        self.core = Core(Parts(config, renew, self.acquisition, self.workers, self.archive, self.log, RunIds(), watch))
        self.core.acquisition_message(messages.Ready(2))

    @property
    def state(self) -> str:
        return str(self.core.machine.state)

    def events(self, kind: str) -> list[str]:
        return [event.message for event in self.log.read(0, 0.0, 1000) if event.kind == kind]

    def arm(self) -> str:
        """Arm the line; returns the run that was granted."""
        self.core.arm(self.order, None, Completion())
        self.core.acquisition_message(messages.Armed())
        return self._granted()

    def _granted(self) -> str:
        return next(c.run for c in reversed(self.acquisition.commands) if isinstance(c, messages.Grant))

    def begin(self) -> str:
        """Let a board interrupt the barrier; returns its run."""
        run = self._granted() if self.state == "armed" else self.arm()
        self.core.acquisition_message(messages.RunStarted(run, 0, time.monotonic()))
        return run

    def row(self, run: str) -> tuple[FrameRecord, ...]:
        self.core.acquisition_message(messages.PulseReported(run, Pulse(index=0, time_s=100.0)))
        records = tuple(FrameRecord(camera=k, row=0, verdict=Verdict.OK, slot=k) for k in (0, 1))
        for record in records:
            self.core.acquisition_message(messages.FrameSettled(run, record, time.monotonic()))
        return records

    def film(self, reason: str = "clear") -> str:
        """Let a board of one row pass, and answer its links; returns its run."""
        records = self.row(run := self.begin())
        report = messages.RunFinished(run, 0, a_head(1), records, time.monotonic(), reason)
        self.core.acquisition_message(report)
        for job in self.workers.of(LinkJob, run):
            self.workers.answer(job)
        return run

    def conclude(self, run: str, status: Status = Status.OK, later: tuple[str, ...] = ()) -> None:
        [job] = self.workers.of(ConcludeJob, run)
        stitch = a_stitch(a_head(1), status)
        if later:
            stitch = stitch.model_copy(update={"quality": {**stitch.quality, "later": list(later)}})
        self.workers.answer(job, Concluded(without_components(stitch), stitch_text(stitch)))


@pytest.fixture
def station(config: StationConfig, store: Store, calibration: Calibration, progress: Progress) -> Station:
    return Station(config, store, calibration, progress.order)


def test_a_board_gets_its_bay_and_the_next_bay_is_granted(station: Station) -> None:
    run = station.begin()
    assert station.state == "filming"
    assert [bay.use for bay in station.core.memory.bays()] == ["filming", "granted", "free"]
    with pytest.raises(StateError, match="its memory is needed"):
        station.core.release(run)


def test_a_missed_board_is_counted_and_names_the_memory_if_that_is_the_cause(station: Station) -> None:
    station.core.acquisition_message(messages.BoardMissed(1.0, "no memory was granted."))
    [event] = [e for e in station.log.read(0, 0.0, 100) if e.kind == "board-missed"]
    assert event.message == "A board passed and was not filmed: no memory was granted."
    assert event.action.startswith("Memory: ")
    assert station.core.boards.missed == 1


@pytest.mark.parametrize(
    ("status", "reason", "state", "checks"),
    [
        (Status.OK, "clear", "ready", 1),
        (Status.DEGRADED, "single", "degraded", 1),
        (Status.FAILED, "clear", "failed", 0),
        (Status.OK, "disarmed", "degraded", 0),
        (Status.OK, "max-rows", "degraded", 0),
    ],
)
def test_a_run_ends_with_the_verdict_of_its_result_and_only_a_whole_one_is_evidence_of_drift(
    station: Station, status: Status, reason: str, state: str, checks: int
) -> None:
    run = station.film(reason)
    station.conclude(run, status)
    assert station.archive.get(run).detail.state == state
    assert station.archive.get(run).result.status == ("degraded" if state == "degraded" else status)
    assert (station.core.active, station.workers.open) == ({}, [])
    [job] = station.workers.of(ExplainJob, run)
    assert (job.check is not None) == bool(checks)
    assert job.status == station.archive.get(run).result.status, "that of the run, whose faults lower it"


def test_a_result_is_announced_at_once_and_completed_by_its_explanation(station: Station, store: Store) -> None:
    run = station.film()
    station.conclude(run, later=("heights_mm",))
    first = station.archive.get(run)
    assert (first.detail.state, first.detail.verdict, first.complete) == ("ready", "ok", False)
    [job] = station.workers.of(ExplainJob, run)
    whole = explained(first.result)
    station.workers.answer(job, Explained(Reply(stitch_text(whole), None, 0.0), None))
    finished = station.archive.explained(run)
    assert finished.complete
    store.set_state(run, "ready").result()  # writes are done in their order
    assert finished.text == store.result(run) == stitch_text(whole)
    assert (finished.detail.state, finished.lean.status) == ("ready", "ok")
    [event] = [e for e in station.log.read(0, 0.0, 100) if e.code == "explained"]
    assert (event.kind, event.state, event.run) == ("run", "", run), "for those who wait for runs, a run ends once"


def test_an_explanation_that_is_lost_is_stated_and_leaves_the_verdict(station: Station) -> None:
    run = station.film()
    station.conclude(run, later=("heights_mm",))
    assert not station.archive.explained(run, 0.05).complete, "it is not awaited for ever"
    [job] = station.workers.of(ExplainJob, run)
    station.workers.answer(job, None, InternalError("its worker has ended."))
    _, again = station.workers.of(ExplainJob, run)
    opening, conclusion = again.again
    assert (opening.context.run, [conclusion]) == (run, station.workers.of(ConcludeJob, run))
    station.workers.answer(again, None, InternalError("its worker has ended."))
    finished = station.archive.get(run)
    assert (finished.complete, finished.detail.state, finished.result.quality["later"]) == (
        False, "ready", ["heights_mm"],
    )  # fmt: skip
    troubles = [e for e in station.log.read(0, 0.0, 100) if e.kind == "trouble"]
    assert [e.code for e in troubles] == ["explanation-lost", "calibration-not-checked"]
    assert "its worker has ended" in troubles[0].message


def test_a_stop_waits_for_the_explanation_of_the_last_run(station: Station) -> None:
    run, stopped = station.film(), Completion()
    station.core.stop(stopped)
    station.conclude(run, later=("heights_mm",))
    assert not stopped.done()
    [job] = station.workers.of(ExplainJob, run)
    station.workers.answer(
        job, Explained(Reply(stitch_text(explained(station.archive.get(run).result)), None, 0.0), None)
    )
    assert stopped.done()


def test_an_early_result_waits_for_the_run_before_it(station: Station) -> None:
    first, second = station.film(), station.film()
    station.conclude(second)
    assert [*station.core.active] == [first, second]
    station.conclude(first)
    assert station.core.active == {}
    numbers = [station.archive.get(run).finish_number for run in (first, second)]
    assert numbers == sorted(numbers)


def test_what_had_arrived_is_stitched_when_the_acquisition_process_ends(station: Station) -> None:
    run = station.begin()
    for index, time_s in ((0, 9.0), (1, 9.1000000004), (3, 9.3)):
        station.core.acquisition_message(messages.PulseReported(run, Pulse(index=index, time_s=time_s)))
    for camera, row in ((0, 0), (1, 0), (0, 1), (0, 3)):
        record = FrameRecord(camera=camera, row=row, verdict=Verdict.OK, slot=row)
        station.core.acquisition_message(messages.FrameSettled(run, record, 51.0))
    station.core.acquisition_ended("the acquisition process ended (code -9)")
    progress = station.core.active[run]
    assert (str(progress.state), station.state) == ("stitching", "faulted")
    assert [fault.code for fault in progress.faults] == ["acquisition-lost"]
    assert station.events("trouble") == ["The acquisition process ended (code -9)."]
    film = progress.recorded
    assert film is not None
    assert (film.head.rows, film.head.trigger_times_s, film.head.missing) == (2, (0.0, 0.1), ((1, 1),))
    assert [f.verdict for f in film.frames] == [Verdict.OK, Verdict.OK, Verdict.OK, Verdict.MISSING]
    assert (film.frames[-1].cause, film.reason) == (CAUSE, "acquisition lost")


def test_a_camera_is_exchanged_only_while_no_board_may_come(station: Station) -> None:
    station.arm()
    with pytest.raises(StateError, match="The line is armed; nothing was changed"):
        station.core.exchange_camera(1, "S9", "192.168.7.9", None)
    station.core.line.disarm(Completion())
    station.core.acquisition_message(messages.Disarmed(()))
    station.core.exchange_camera(1, "S9", "192.168.7.9", None)
    assert station.acquisition.commands[-1] == messages.ReplaceCamera(1, "S9", "192.168.7.9")
    exchanged = station.core.config.cameras[1]
    assert (exchanged.serial, exchanged.address) == ("S9", None)
    assert any("S9 is in the place of" in message for message in station.events("camera"))


def test_a_camera_is_not_exchanged_if_that_cannot_be_stored(station: Station) -> None:
    def refuse(_config: StationConfig) -> None:
        raise DeviceError("The disk is full.", code="storage-full")

    station.core._parts = replace(station.core._parts, use_config=refuse)
    with pytest.raises(DeviceError, match="The disk is full"):
        station.core.exchange_camera(1, "S9", "192.168.7.9", None)
    assert not any(isinstance(command, messages.ReplaceCamera) for command in station.acquisition.commands)
    assert station.core.config.cameras[1].serial != "S9"


def test_a_place_named_by_address_keeps_its_serial_number_over_a_restart(
    config: StationConfig, store: Store, calibration: Calibration, progress: Progress
) -> None:
    cameras = [c.model_copy(update={"address": f"10.0.0.{k}"}) for k, c in enumerate(config.cameras)]
    config = config.model_copy(update={"cameras": tuple(cameras)})
    there = CameraHealth(connected=True, serial="S0", model="M", address="10.0.0.0")
    places = CameraPlaces(store.standing, 2)
    places.note(messages.Health((there, CameraHealth(connected=False)), "", 0.0), config.cameras)
    store.standing.set("later", "").result()
    places = CameraPlaces(store.standing, 2)
    to_open = places.to_open(config)
    assert [camera.serial for camera in to_open.cameras] == ["S0", None]
    assert [camera.address for camera in to_open.cameras] == ["10.0.0.0", "10.0.0.1"]
    renamed = config.cameras[0].model_copy(update={"address": "10.0.0.9"})
    moved = config.model_copy(update={"cameras": (renamed, config.cameras[1])})
    assert places.to_open(moved) == moved, "an edit of station.toml is meant so"


def test_an_order_with_a_calibration_that_is_not_in_force_any_more_is_refused(station: Station) -> None:
    late = replace(station.order, calibration_digest="of-before")
    with pytest.raises(StateError, match="The calibration was changed at this moment"):
        station.core.arm(late, None, Completion())
    assert station.state == "idle"

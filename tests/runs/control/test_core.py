"""The decisions of the coordinator's thread, called directly: messages, replies, releases, leases and the stop."""

from __future__ import annotations

import time
from typing import Any

import pytest

from tests.runs.doubles import Acquisition, CountingRing, Workers
from vaoi_station.acquisition.process import messages
from vaoi_station.config import StationConfig
from vaoi_station.errors import InternalError, StateError
from vaoi_station.model import Calibration, FrameRecord, Pulse, Verdict
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.line_control import Completion
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.workers.jobs import LinkJob, Reply
from vaoi_station.store import Store


class Station:
    """A core on doubles; `events` are the messages published so far."""

    def __init__(self, config: StationConfig, store: Store, calibration: Calibration, order: Order) -> None:
        self.log = EventLog(store)
        self.acquisition, self.workers, self.order = Acquisition(), Workers(), order
        archive = Archive(store, self.log)
        watch = CalibrationWatch(store.checks, self.log, calibration, ["left", "right"])
        self.core = Core(
            Parts(config, CountingRing(), self.acquisition, self.workers, archive, self.log, RunIds(), watch)
        )
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
        return next(c.run for c in self.acquisition.commands if isinstance(c, messages.Grant))

    def begin(self) -> str:
        """Arm, and let a board interrupt the barrier; returns its run."""
        run = self.arm()
        self.core.acquisition_message(messages.RunStarted(run, 0, time.monotonic()))
        return run

    def row(self, run: str) -> None:
        self.core.acquisition_message(messages.PulseReported(run, Pulse(index=0, time_s=100.0)))
        for camera in (0, 1):
            record = FrameRecord(camera=camera, row=0, verdict=Verdict.OK, slot=camera)
            self.core.acquisition_message(messages.FrameSettled(run, record, time.monotonic()))


@pytest.fixture
def station(config: StationConfig, store: Store, calibration: Calibration, progress: Progress) -> Station:
    return Station(config, store, calibration, progress.order)


def test_arming_is_published_with_the_board_type(station: Station) -> None:
    station.arm()
    assert station.events("armed") == ["Armed for board type 'small'."]
    assert station.state == "armed"


def test_a_board_gets_its_bay_and_the_next_bay_is_granted(station: Station) -> None:
    run = station.begin()
    assert station.state == "filming"
    assert [bay.use for bay in station.core.memory.bays()] == ["filming", "granted", "free"]
    with pytest.raises(StateError, match="its memory is needed"):
        station.core.release(run)


def test_a_run_without_an_order_is_a_reason_and_gets_no_memory(station: Station) -> None:
    station.core.acquisition_message(messages.RunStarted("never", 0, time.monotonic()))
    assert station.events("trouble") == ["Run never was filmed without an order."]
    assert station.core.runs.active == {}


def test_a_missed_board_is_counted_and_names_the_memory_if_that_is_the_cause(station: Station) -> None:
    station.core.acquisition_message(messages.BoardMissed(1.0, "no memory was granted."))
    [event] = [e for e in station.log.read(0, 0.0, 100) if e.kind == "board-missed"]
    assert event.message == "A board passed and was not filmed: no memory was granted."
    assert event.action.startswith("Memory: ")
    assert station.core.boards.missed == 1


def test_what_had_arrived_is_stitched_when_the_acquisition_process_ends(station: Station) -> None:
    run = station.begin()
    station.row(run)
    station.core.acquisition_ended("the acquisition process ended (code -9)")
    progress = station.core.runs.active[run]
    assert (str(progress.state), station.state) == ("stitching", "faulted")
    assert [fault.code for fault in progress.faults] == ["acquisition-lost"]
    assert progress.recorded is not None
    assert progress.recorded.head.rows == 1
    assert station.events("trouble") == ["The acquisition process ended (code -9)."]


def test_a_run_without_a_pulse_fails_when_the_acquisition_process_ends(station: Station) -> None:
    station.begin()
    station.core.acquisition_ended("the acquisition process ended (code -9)")
    assert station.core.runs.active == {}
    assert [bay.use for bay in station.core.memory.bays()] == ["finished", "free", "free"]


def test_a_stop_completes_when_the_last_run_has_ended(station: Station) -> None:
    run = station.begin()
    station.row(run)
    stopped = Completion()
    station.core.stop(stopped)
    assert not stopped.done()
    station.core.acquisition_ended("the acquisition process ended")
    job: Any = next(job for job in station.workers.jobs if isinstance(job, LinkJob))
    lost = Reply(None, InternalError("it died", code="worker-lost"), 0.0)
    station.core.worker_reply(job, lost, time.monotonic())
    stopped.result(0)
    assert station.state == "stopping"


def test_expired_leases_are_published(station: Station) -> None:
    station.core.leases.lease_s = 0.0
    station.core.leases.take("r1", "tester 3", "AOI")
    station.core.tick()
    assert station.events("lease") == ["The hold of tester 3 (AOI) expired."]


def test_events_of_the_workers_are_logged(station: Station) -> None:
    station.core.worker_ended("Worker 0 ended with code -9.")
    station.core.workers_ready()
    assert station.events("process") == ["Worker 0 ended with code -9."]
    assert station.events("workers") == ["The workers are ready: results come at once."]

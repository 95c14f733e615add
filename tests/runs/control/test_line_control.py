"""Arming and disarming with a scripted acquisition process: requests, replies, and memory granted ahead of time."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from tests.runs.doubles import Acquisition, CountingRing
from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.process import messages
from vaoi_station.backoff import BackoffPolicy
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import line_control
from vaoi_station.runs.control.line_control import Completion, LineControl
from vaoi_station.runs.control.reasons import StationStateMachine
from vaoi_station.runs.run.memory import Memory
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.states.tables import StationStep
from vaoi_station.store import Store


class Line:
    """A line control with its parts, ready and idle."""

    def __init__(self, config: StationConfig, store: Store, order: Order) -> None:
        events = EventLog(store)
        self.memory = Memory(CountingRing().renew, 2, 600.0)
        self.machine, self.acquisition, self.order = StationStateMachine(events), Acquisition(), order
        self.control = LineControl(
            config, self.acquisition, self.machine, self.memory, RunIds(), Archive(store, events), events
        )
        self.control.on_ready()

    def arm(self, runs: int | None = None) -> Completion:
        armed = Completion()
        self.control.arm(self.order, runs, armed)
        return armed

    def armed(self) -> None:
        self.arm()
        self.control.on_armed()

    @property
    def state(self) -> str:
        """State of the station."""
        return str(self.machine.state)

    def granted(self) -> list[str]:
        return [bay.run for bay in self.memory.bays() if bay.use == "granted" and bay.run]


@pytest.fixture
def line(config: StationConfig, store: Store, progress: Progress) -> Line:
    return Line(config, store, progress.order)


def test_memory_is_granted_before_the_cameras_are_armed(line: Line) -> None:
    armed = line.arm()
    assert line.acquisition.taken() == ["Grant", "Arm"]
    assert not armed.done()
    line.control.on_armed()
    armed.result(0)
    assert line.state == "armed"
    assert line.control.has_grant


def filming(line: Line) -> None:
    line.armed()
    line.machine.advance(StationStep.BOARD_ARRIVED)


def board_leaves(line: Line) -> None:
    line.machine.advance(StationStep.BOARD_FILMED)
    line.control.board_left()


def test_a_board_at_the_barrier_keeps_its_order_when_several_wait(line: Line) -> None:
    filming(line)
    before = line.control.orders.order
    early = time.monotonic()
    line.order = replace(line.order, board_id="A")
    first = line.arm(runs=2)
    line.order = replace(line.order, board_id="B")
    second = line.arm(runs=3)
    board_leaves(line)
    first.result(0)
    second.result(0)
    assert line.control.orders.runs_left == 3
    assert line.control.orders.take(early) is before


def test_a_board_missed_before_a_request_takes_effect_makes_its_id_uncertain(line: Line) -> None:
    filming(line)
    line.order = replace(line.order, board_id="A")
    line.arm()
    missed_s = time.monotonic()
    line.control.orders.doubt(missed_s, missed_s, "a board was missed")
    board_leaves(line)
    assert line.control.orders.present_doubt == "a board was missed"
    line.arm()
    assert line.control.orders.present_doubt is None


def test_disarming_returns_unused_memory_and_a_waiting_order_is_armed_afterwards(line: Line) -> None:
    line.armed()
    [run] = line.granted()
    disarmed = Completion()
    line.control.disarm(disarmed)
    waiting = line.arm()
    assert line.acquisition.taken() == ["Grant", "Arm", "Disarm"]
    line.control.on_disarmed(messages.Disarmed((messages.Grant(run, 0),)))
    disarmed.result(0)
    assert line.acquisition.taken() == ["Grant", "Arm"]
    assert run not in line.granted()
    line.control.on_armed()
    waiting.result(0)


def test_an_armed_that_crosses_a_disarm_does_not_arm(line: Line) -> None:
    armed = line.arm()
    line.control.disarm(Completion())
    line.control.on_armed()
    assert line.state == "arming"
    line.control.on_disarmed(messages.Disarmed(()))
    with pytest.raises(StateError, match="disarmed before it was armed"):
        armed.result(0)


def test_an_order_survives_a_trouble_while_the_line_is_armed_again(
    config: StationConfig, store: Store, progress: Progress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_control, "PACE", BackoffPolicy(first_s=0.0, longest_s=0.0, proven_s=1.0))
    line = Line(config, store, progress.order)
    line.armed()
    line.control.on_acquisition_ended("the acquisition process ended")
    line.control.on_ready()
    line.acquisition.taken()
    line.control.on_trouble(messages.Trouble("events-lost", "events were lost", "Check its cable."))
    line.control.tick()
    assert line.acquisition.taken() == ["Disarm"]
    line.control.on_disarmed(messages.Disarmed((messages.Grant(line.granted()[0], 0),)))
    [warning] = line.control.warnings()
    assert (warning.code, "events were lost" in warning.message) == ("not-armed-again", True)
    away = messages.Health((CameraHealth(True), CameraHealth(False, "cable pulled")), "fine", 1.0)
    line.control.health = away
    line.control.tick()
    assert line.acquisition.taken() == []
    assert "Cable pulled" in line.control.warnings()[0].message
    with pytest.raises(DeviceError, match="The array is not complete"):
        line.arm().result(0)
    line.control.health = replace(away, cameras=(CameraHealth(True),) * 2)
    line.control.tick()
    assert line.acquisition.taken() == ["Grant", "Arm"]
    line.control.on_armed()
    assert (line.state, line.control.warnings()) == ("armed", ())

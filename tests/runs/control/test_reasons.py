"""The station's state, its reasons, and what holds boards back."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.process.messages import Trouble
from vaoi_station.errors import StateError
from vaoi_station.model import Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.control.reasons import TROUBLE_S, Reasons, StationStateMachine
from vaoi_station.runs.states.tables import StationStep
from vaoi_station.store import Store


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_a_reason_holds_until_it_is_taken_back() -> None:
    clock = Clock()
    reasons, full = Reasons(clock), Reason(code="ring-full", message="full")
    assert reasons.hold(full)
    assert not reasons.hold(full)
    clock.now_s += 100 * TROUBLE_S
    reasons.expire()
    assert reasons.all() == (full,)
    reasons.drop("ring-full")
    reasons.drop("ring-full")
    assert reasons.all() == ()


def test_a_trouble_lasts_as_long_as_it_is_reported() -> None:
    clock = Clock()
    reasons, cable = Reasons(clock), Trouble("device", "camera 1 is silent", "Check its cable.")
    assert reasons.trouble(cable) is not None
    assert reasons.trouble(Trouble("device", "camera 2 is silent", "")) is not None
    clock.now_s += TROUBLE_S
    assert reasons.trouble(cable) is None
    clock.now_s += 1.0
    reasons.expire()
    assert [reason.message for reason in reasons.all()] == ["Camera 1 is silent"]
    reasons.clear()
    assert reasons.all() == ()
    assert reasons.trouble(cable) is not None


@pytest.fixture
def events(store: Store) -> EventLog:
    return EventLog(store)


@pytest.fixture
def machine(events: EventLog) -> StationStateMachine:
    return StationStateMachine(events)


def test_a_refusal_names_state_reason_and_action(machine: StationStateMachine) -> None:
    machine.require(StationStep.READY)
    machine.add_reason("port-absent", "There is no serial port.", "Plug it in.")
    with pytest.raises(StateError, match=r"is starting \(There is no serial port\.\); arm is not possible") as refusal:
        machine.require(StationStep.ARM)
    assert refusal.value.action.startswith("Wait")

"""The station's state machine: legal events are published, illegal ones refused or ignored."""

from __future__ import annotations

import pytest

from vaoi_station.errors import StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.control.station_state import StationStateMachine
from vaoi_station.runs.states.tables import StationState, StationStep
from vaoi_station.store import Store


@pytest.fixture
def events(store: Store) -> EventLog:
    return EventLog(store)


@pytest.fixture
def machine(events: EventLog) -> StationStateMachine:
    return StationStateMachine(events)


def test_a_change_of_state_is_an_event_and_a_step_without_change_is_none(
    machine: StationStateMachine, events: EventLog
) -> None:
    for step in (StationStep.READY, StationStep.ARM, StationStep.ARMED, StationStep.ARM):
        machine.advance(step)
    assert machine.state is StationState.ARMED
    assert [e.state for e in events.read(0, 0.0, 10)] == ["idle", "arming", "armed"]


def test_an_illegal_event_changes_nothing(machine: StationStateMachine, events: EventLog) -> None:
    with pytest.raises(StateError, match="The station is starting"):
        machine.advance(StationStep.ARMED)
    machine.advance_if_allowed(StationStep.ARMED)
    assert machine.state is StationState.STARTING
    assert events.last == 0


def test_a_refusal_names_state_reason_and_action(machine: StationStateMachine) -> None:
    machine.require(StationStep.READY)
    machine.add_reason("port-absent", "There is no serial port.", "Plug it in.")
    with pytest.raises(StateError, match=r"is starting \(There is no serial port\.\); arm is not possible") as refusal:
        machine.require(StationStep.ARM)
    assert refusal.value.action.startswith("Wait")


def test_a_reason_is_published_when_it_is_new(machine: StationStateMachine, events: EventLog) -> None:
    for action in ("Plug it in.", "Plug it in.", "Replace it."):
        machine.add_reason("port-absent", "There is no serial port.", action)
    assert [e.action for e in events.read(0, 0.0, 10)] == ["Plug it in.", "Replace it."]
    assert [r.action for r in machine.reasons.all()] == ["Replace it."]

"""The tables are complete where they must be, and refuse everything else without a trace."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from vaoi_station.errors import StateError
from vaoi_station.runs.states.tables import (
    FINISHED,
    IN_MEMORY,
    RUN,
    STATION,
    RunState,
    RunStep,
    StationState,
    StationStep,
    Table,
)


def reachable(table: Table[Any, Any], start: Any) -> set[Any]:
    found, open_ends = {start}, [start]
    while open_ends:
        state = open_ends.pop()
        new = {target for (source, _), target in table.steps.items() if source is state} - found
        found |= new
        open_ends += new
    return found


@pytest.mark.parametrize(("table", "states"), [(STATION, StationState), (RUN, RunState)])
def test_every_state_can_be_reached(table: Table[Any, Any], states: Any) -> None:
    assert reachable(table, table.start) == set(states)


@pytest.mark.parametrize("state", RunState)
def test_every_run_comes_to_an_end(state: RunState) -> None:
    assert reachable(RUN, state) & {RunState.RELEASED, RunState.GONE}
    assert (state in FINISHED) == (reachable(RUN, state) <= FINISHED)
    assert IN_MEMORY < FINISHED


@given(st.sampled_from(list(StationState)), st.sampled_from(list(StationStep)))
def test_an_illegal_event_is_refused_by_name(state: StationState, event: StationStep) -> None:
    if STATION.allows(state, event):
        assert STATION.next(state, event) in StationState
    else:
        with pytest.raises(StateError, match=f"The station is {state}; {event}") as refusal:
            STATION.next(state, event, action="Wait.")
        assert refusal.value.action == "Wait."


class Walk(RuleBasedStateMachine):
    """Any sequence of events, legal or not, leaves both machines in a state of their table."""

    def __init__(self) -> None:
        super().__init__()
        self.station, self.run = STATION.start, RUN.start
        self.ended = False

    @rule(event=st.sampled_from(list(StationStep)))
    def happen(self, event: StationStep) -> None:
        before = self.station
        try:
            self.station = STATION.next(before, event)
        except StateError:
            assert self.station is before
            assert (before, event) not in STATION.steps

    @rule(event=st.sampled_from(list(RunStep)))
    def proceed(self, event: RunStep) -> None:
        before = self.run
        try:
            self.run = RUN.next(before, event)
        except StateError:
            assert self.run is before
        self.ended = self.ended or self.run in FINISHED

    @invariant()
    def finished_stays_finished(self) -> None:
        assert not self.ended or self.run in FINISHED


TestWalk = Walk.TestCase

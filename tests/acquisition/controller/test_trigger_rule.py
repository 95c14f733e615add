"""The firmware's rule: from the barrier's edges to pulses, exactly and without drift."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierClear,
    BarrierClearAfterRun,
    BeltPacing,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.trigger_rule import TriggerRule
from vaoi_station.errors import InputError

PLAN = TriggerPlan(start_delay_s=0.3, period_s=0.1, tail_s=0.45, max_rows=20, debounce_s=0.005, lights=("a", "b"))


def run(plan: TriggerPlan, edges: list[tuple[float, bool]], steps: list[float] | None = None) -> list[ControllerEvent]:
    """All events for edges, asked at the edges, at `steps`, and long after."""
    rule = TriggerRule(plan, count())
    events: list[ControllerEvent] = []
    moments = sorted([(t, 0, b) for t, b in edges] + [(t, 1, False) for t in steps or []])
    for time_s, kind, blocked in moments:
        events += rule.advance(time_s)
        if kind == 0:
            rule.add_edge(time_s, blocked)
    return events + rule.advance(1e6)


def pulses(events: list[ControllerEvent]) -> list[PulseFired]:
    return [e for e in events if isinstance(e, PulseFired)]


def ended(events: list[ControllerEvent], time_s: float) -> tuple[int, str]:
    """Pulses and reason of a run that ended at a time."""
    last = events[-1]
    assert isinstance(last, RunEnded)
    assert last.time_s == pytest.approx(time_s)
    return last.pulses, last.reason


def test_every_edge_of_boards_that_follow_too_closely_is_an_event() -> None:
    """Three boards of 50 mm, 40 mm apart, at 100 mm/s: the tail of deploy/station.toml is 48 mm long."""
    plan = replace(PLAN, start_delay_s=0.32, period_s=0.105, tail_s=0.48, max_rows=11)
    edges = [(1.0 + 0.9 * k + after, blocked) for k in range(3) for after, blocked in ((0.0, True), (0.5, False))]
    events = run(plan, edges)
    edge_events = [e for e in events if not isinstance(e, PulseFired | RunEnded)]
    assert [(round(e.time_s, 3), type(e)) for e in edge_events] == [
        (1.0, BarrierBlocked),
        (1.5, BarrierClear),
        (1.9, BarrierBlockedAgain),
        (2.4, BarrierClearAfterRun),
        (2.8, BarrierBlocked),
        (3.3, BarrierClear),
    ]
    assert [e.reason for e in events if isinstance(e, RunEnded)] == ["max-rows", "clear"]


@given(
    st.floats(0, 1e5),
    st.floats(0.01, 3),
    st.floats(0.01, 0.5),
    st.lists(st.floats(0, 5), max_size=30),
    st.integers(1, 40),
)
def test_the_times_of_evaluation_do_not_matter(
    start_s: float, passing_s: float, period_s: float, asked_s: list[float], max_rows: int
) -> None:
    plan = replace(PLAN, period_s=period_s, max_rows=max_rows)
    edges = [(start_s, True), (start_s + passing_s, False)]
    at_once, step_by_step = run(plan, edges), run(plan, edges, [start_s + t for t in asked_s])
    assert at_once == step_by_step
    for k, pulse in enumerate(pulses(at_once)):
        assert pulse.index == k
        assert pulse.time_s == start_s + plan.start_delay_s + k * period_s, "no error adds up"
        assert pulse.time_s <= start_s + passing_s + max(plan.tail_s, plan.debounce_s)


@pytest.mark.parametrize(
    ("change", "key"),
    [({"period_s": 0.0}, "period_s"), ({"max_rows": 0}, "max_rows"), ({"tail_s": 0.001}, "tail_s"),
     ({"start_delay_s": 0.004}, "start_delay_s"), ({"debounce_s": float("nan")}, "start_delay_s")],
)  # fmt: skip
def test_plans_that_cannot_be_carried_out_are_refused(change: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=key):
        TriggerRule(replace(PLAN, **change), count())  # type: ignore[arg-type]


class Belt:
    """20 counts per mm at 100 mm/s; at half the speed from 1.5 s on, and at rest from 9 s on."""

    def counts_at(self, time_s: float) -> int:
        time_s = min(time_s, 9.0)
        return int(2000 * min(time_s, 1.5) + 1000 * max(time_s - 1.5, 0.0) + 1e-6)

    def time_of(self, counts: int) -> float:
        time_s = counts / 2000 if counts <= 3000 else 1.5 + (counts - 3000) / 1000
        return time_s if time_s <= 9.0 else float("inf")


PACING = BeltPacing(counts_per_mm=20.0, start=600, row=200, tail=900, shortest_s=0.09)
BELT = replace(PLAN, belt=PACING)


def run_on_belt(plan: TriggerPlan, edges: list[tuple[float, bool]]) -> list[ControllerEvent]:
    rule, events = TriggerRule(plan, count(), Belt()), []
    for time_s, blocked in edges:
        events += rule.advance(time_s)
        rule.add_edge(time_s, blocked)
    return events + rule.advance(1e6)


def test_rows_keep_their_places_on_a_belt_that_slows_down() -> None:
    events = run_on_belt(BELT, [(1.0, True), (1.52, False)])
    # counts 2600 … 3800; the barrier was clear at 3020 and the tail ends at 3920
    places = [1.3, 1.4, 1.5, 1.7, 1.9, 2.1, 2.3]
    assert [p.time_s for p in pulses(events)] == pytest.approx([t + 1e-3 for t in places])
    assert ended(events, pulses(events)[-1].time_s) == (7, "clear")
    assert [p.time_s for p in pulses(run_on_belt(PLAN, [(1.0, True), (1.52, False)]))] == pytest.approx(
        [1.3 + 0.1 * k for k in range(7)]
    ), "without counts in the plan the clock spaces the rows"


def test_rows_that_come_too_soon_are_skipped_and_keep_their_number() -> None:
    dense = replace(BELT, belt=replace(PACING, row=120))
    events = run_on_belt(dense, [(1.0, True), (1.2, False)])
    rows = [(type(e), e.index) for e in events if isinstance(e, PulseFired | PulseSkipped)]
    assert rows[:4] == [(PulseFired, 0), (PulseSkipped, 1), (PulseFired, 2), (PulseSkipped, 3)]
    assert ended(events, events[-2].time_s)[0] == len(rows)

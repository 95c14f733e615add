"""The firmware's rules, built for this computer: the same as the simulated controller's, and safe under a fuzzer."""

from __future__ import annotations

import ctypes
import re
import subprocess
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.hw.emulated.chip import make
from tests.hw.emulated.line import TIMING, ms, us
from tests.needs import LONG, need
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierClear,
    BarrierClearAfterRun,
    BeltPacing,
    ControllerEvent,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.protocol import (
    TICK_S,
    Event,
    FrameReader,
    Kind,
    Message,
    Nak,
    Pacing,
    Reason,
    Request,
    RunEnd,
    Step,
    Timing,
    Type,
    arm,
    config_crc,
    configuration,
    encode,
)
from vaoi_station.acquisition.controller.trigger_rule import TriggerRule

LIGHT = [Step(1, us(100))]
RULE = replace(TIMING, steps=1, min_gap=0, min_period=ms(5))
ROUND = us(256)
"""Time of one round of the main loop here, ticks."""


def talk(logic: ctypes.CDLL, requests: list[Request], now: int = 0) -> list[Message]:
    data = b"".join(encode(Message(r.type, k, r.payload)) for k, r in enumerate(requests))
    replies = ctypes.create_string_buffer(80 * len(requests))
    size = logic.bridge_talk(data, len(data), replies, ctypes.c_uint32(now))
    return FrameReader().feed(replies.raw[:size])


def firmware_events(logic: ctypes.CDLL, timing: Timing, edges: list[tuple[int, bool]]) -> list[Event]:
    """All events of a barrier that changes so; the main loop comes round in the middle of nothing."""
    logic.bridge_start(0)
    replies = talk(logic, [*configuration(timing, LIGHT), arm(1, config_crc(timing, LIGHT))])
    assert all(reply.type != Type.NAK for reply in replies)
    events: list[Event] = []
    waiting = list(edges)
    end = edges[-1][0] + timing.tail + timing.start_delay + timing.max_rows * timing.period + ms(50)
    struct = ctypes.create_string_buffer(16)
    for now in range(0, end, ROUND):
        if now % ms(250) == 0:
            talk(logic, [Request(Type.BEAT)], now)
        while waiting and waiting[0][0] <= now:
            tick, blocked = waiting.pop(0)
            logic.bridge_edge(ctypes.c_uint32(tick), int(blocked))
        logic.bridge_poll(ctypes.c_uint32(now))
        while logic.bridge_event(struct) & 0xFF:
            events.append(Event.unpack(struct.raw))
    return events


def test_a_departure_is_no_gap_again_after_the_counter_has_wrapped(logic: ctypes.CDLL) -> None:
    """A board that comes 35.8 min after the one before, to within the gap, is filmed."""
    timing, wrap = replace(RULE, min_gap=ms(500)), 1 << 32
    logic.bridge_start(0)
    talk(logic, [*configuration(timing, LIGHT), arm(1, config_crc(timing, LIGHT))])
    again = wrap + ms(310 + 200)
    edges = [(ms(10), True), (ms(100), False), (ms(300), True), (ms(310), False), (again, True)]
    fine = [*range(0, ms(1000), us(256)), *range(again - ms(1), again + ms(20), us(256))]
    coarse = range(ms(1000), again - ms(1), ms(500))
    struct, seen = ctypes.create_string_buffer(16), []
    for now in sorted({*fine, *coarse}):
        talk(logic, [Request(Type.BEAT)], now)
        while edges and edges[0][0] <= now:
            tick, blocked = edges.pop(0)
            logic.bridge_edge(ctypes.c_uint32(tick), int(blocked))
        logic.bridge_poll(ctypes.c_uint32(now))
        while logic.bridge_event(struct) & 0xFF:
            event = Event.unpack(struct.raw)
            if (event.kind, event.detail) in ((Kind.BARRIER, 1), (Kind.SUPPRESSED, 1), (Kind.SUPPRESSED, 2)):
                seen.append(event.kind)
    assert seen == [Kind.BARRIER, Kind.SUPPRESSED, Kind.BARRIER]


def rule_events(timing: Timing, edges: list[tuple[int, bool]]) -> list[ControllerEvent]:
    """What the simulated controller makes of the same edges."""
    plan = TriggerPlan(
        timing.start_delay * TICK_S,
        timing.period * TICK_S,
        timing.tail * TICK_S,
        timing.max_rows,
        timing.debounce * TICK_S,
    )
    rule = TriggerRule(plan, count())
    events: list[ControllerEvent] = []
    for tick, blocked in edges:
        events += rule.advance(tick * TICK_S)
        rule.add_edge(tick * TICK_S, blocked)
    return events + rule.advance(1e6)


@settings(max_examples=40)
@given(
    intervals=st.lists(st.integers(us(200), ms(60)), min_size=2, max_size=8),
    period=st.integers(ms(5), ms(40)),
    delay=st.integers(ms(6), ms(40)),
    tail=st.integers(ms(6), ms(40)),
    max_rows=st.integers(1, 8),
)
def test_the_same_rule_as_the_simulated_controller(
    logic: ctypes.CDLL, intervals: list[int], period: int, delay: int, tail: int, max_rows: int
) -> None:
    """Odd times against even limits: nothing is decided by half a tick."""
    timing = replace(RULE, period=period | 1, start_delay=delay & ~1, tail=tail & ~1, max_rows=max_rows)
    edges, tick = [], ms(10)
    for k, interval in enumerate(intervals):
        edges.append((tick, k % 2 == 0))
        tick += (interval & ~1) + 2
    if len(edges) % 2:
        edges.append((tick, False))
    theirs = rule_events(timing, edges)
    # Within one round of the main loop an edge is confirmed before a pulse that was due sooner is noticed.
    due = [round(e.time_s / TICK_S) for e in theirs if isinstance(e, PulseFired)]
    assume(not any(0 <= edge + timing.debounce - pulse <= ROUND for edge, _ in edges for pulse in due))
    ours = firmware_events(logic, timing, edges)
    pulses = [(e.index, round(e.time_s / TICK_S)) for e in theirs if isinstance(e, PulseFired)]
    assert [(e.index, e.tick) for e in ours if e.kind == Kind.PULSE] == pulses
    begun = [round(e.time_s / TICK_S) for e in theirs if isinstance(e, BarrierBlocked)]
    assert [e.tick for e in ours if e.kind == Kind.BARRIER and e.detail] == begun
    edge_kinds = {
        (Kind.BARRIER, 1): BarrierBlocked,
        (Kind.BARRIER, 0): BarrierClear,
        (Kind.EDGE, 1): BarrierBlockedAgain,
        (Kind.EDGE, 0): BarrierClearAfterRun,
    }
    assert [(edge_kinds[Kind(e.kind), e.detail], e.tick) for e in ours if e.kind in (Kind.BARRIER, Kind.EDGE)] == [
        (type(e), round(e.time_s / TICK_S)) for e in theirs if type(e) in edge_kinds.values()
    ]
    ends = [
        (e.pulses, {"clear": RunEnd.CLEAR, "max-rows": RunEnd.MAX_ROWS}[e.reason])
        for e in theirs
        if isinstance(e, RunEnded)
    ]
    assert [(e.index, e.detail) for e in ours if e.kind == Kind.RUN_END] == ends


class Counts:
    """Counts of an encoder at these ticks."""

    def __init__(self, ticks: list[int]) -> None:
        self._ticks = ticks

    def counts_at(self, time_s: float) -> int:
        return sum(tick <= round(time_s / TICK_S) for tick in self._ticks)

    def time_of(self, counts: int) -> float:
        return self._ticks[counts - 1] * TICK_S if 0 < counts <= len(self._ticks) else float("inf")


@pytest.mark.parametrize("tail", [2, 6])
def test_the_same_rows_by_distance_as_the_simulated_controller(logic: ctypes.CDLL, tail: int) -> None:
    """A belt that slows down, with counts in the middle between two turns of the main loop."""
    turn = us(256)
    ticks = [turn * (40 + 30 * k + max(k - 12, 0) * 20) for k in range(60)]
    timing = replace(RULE, pacing=Pacing.DISTANCE, start_delay=3, period=4, tail=tail, max_rows=20, debounce=ms(2))
    edges = [(turn * 50, True), (turn * 600, False)]
    belt = BeltPacing(1.0, timing.start_delay, timing.period, timing.tail, timing.min_period * TICK_S)
    plan = TriggerPlan(1.0, 1.0, 1.0, timing.max_rows, timing.debounce * TICK_S, belt=belt)
    rule, theirs = TriggerRule(plan, count(), Counts(ticks)), []
    for tick, blocked in edges:
        theirs += rule.advance(tick * TICK_S)
        rule.add_edge(tick * TICK_S, blocked)
    theirs += rule.advance(1e6)
    logic.bridge_start(0)
    replies = talk(logic, [*configuration(timing, LIGHT), arm(1, config_crc(timing, LIGHT))])
    assert all(reply.type != Type.NAK for reply in replies)
    struct, ours, left, position = ctypes.create_string_buffer(16), [], list(edges), 0
    for now in range(0, ticks[-1], turn):
        if now % (turn * 900) == 0:
            talk(logic, [Request(Type.BEAT)], now)
        while left and left[0][0] <= now:
            tick, blocked = left.pop(0)
            logic.bridge_edge(ctypes.c_uint32(tick), int(blocked))
        logic.bridge_poll(ctypes.c_uint32(now))
        if (counted := sum(tick <= now for tick in ticks)) != position:
            position = counted
            logic.bridge_encoder(position)
        while logic.bridge_event(struct) & 0xFF:
            ours.append(Event.unpack(struct.raw))
    rows = [(e.index, round(e.time_s / TICK_S)) for e in theirs if isinstance(e, PulseFired)]
    assert [(e.index, e.tick) for e in ours if e.kind == Kind.PULSE] == rows
    assert len(rows) > 3
    end = next(e for e in theirs if isinstance(e, RunEnded))
    assert [(e.detail, e.index) for e in ours if e.kind == Kind.RUN_END] == [(RunEnd.CLEAR, end.pulses)]


@pytest.mark.parametrize(
    ("change", "field", "limit"),
    [
        ({"pacing": 2}, 0, 1),
        ({"steps": 0}, 1, 1),
        ({"steps": 17}, 1, 16),
        ({"max_rows": 0}, 2, 1),
        ({"start_delay": ms(5)}, 3, ms(6)),
        ({"period": ms(5) - 1}, 4, ms(5)),
        ({"tail": ms(5)}, 5, ms(6)),
        ({"min_period": ms(5) - 1}, 6, ms(5)),
        ({"debounce": ms(1000) + 1}, 7, ms(1000)),
        ({"trigger_width": us(50) - 1}, 9, us(50)),
        ({"trigger_width": us(2000) + 1}, 9, us(2000)),
    ],
)
def test_a_timing_that_cannot_be_is_refused_by_field_and_limit(
    logic: ctypes.CDLL, change: dict[str, int], field: int, limit: int
) -> None:
    timing = replace(RULE, **change)
    logic.bridge_start(0)
    commit = Request(Type.COMMIT, config_crc(timing, LIGHT).to_bytes(4, "little"))
    *_, reply = talk(logic, [*configuration(RULE, LIGHT)[:-1], Request(Type.TIMING, timing.pack()), commit])
    assert Nak.unpack(reply.payload) == Nak(Type.COMMIT, Reason.RANGE, field, limit)


@pytest.mark.parametrize(
    ("step", "limit"),
    [
        (Step(1, us(1000) + 1), us(1000)),
        (Step(0b1001, us(500) + 1), us(500)),
        (Step(2, us(50) - 1), us(1000)),
        (Step(16, us(100)), 4),
        (Step(1, ms(5) // 16 + 1), ms(5) // 16),
    ],
)
def test_light_beyond_the_limits_is_refused(logic: ctypes.CDLL, step: Step, limit: int) -> None:
    timing = replace(RULE, period=ms(5)) if limit == ms(5) // 16 else replace(RULE, period=ms(20))
    logic.bridge_start(0)
    *_, reply = talk(logic, configuration(timing, [step]))
    assert Nak.unpack(reply.payload) == Nak(Type.COMMIT, Reason.LED_LIMIT, 16, limit)


@pytest.mark.parametrize(
    ("period", "width", "limit"),
    [(ms(20), us(50) - 1, us(50)), (ms(20), us(10000) + 1, us(10000)), (ms(5), us(2000) + 1, us(2000))],
)
def test_a_width_of_the_trigger_beyond_the_limits_is_refused(
    logic: ctypes.CDLL, period: int, width: int, limit: int
) -> None:
    """50 µs, 10 ms, and 3 ms before the next row."""
    timing = replace(RULE, period=period, steps=2)
    logic.bridge_start(0)
    *_, reply = talk(logic, configuration(timing, LIGHT * 2, [timing.trigger_width, width]))
    assert Nak.unpack(reply.payload) == Nak(Type.COMMIT, Reason.RANGE, 33, limit)
    *_, reply = talk(logic, configuration(timing, LIGHT * 2, [timing.trigger_width, limit]))
    assert reply.type == Type.COMMIT | 0x80


def test_the_boot_counter_survives_a_write_that_failed(logic: ctypes.CDLL) -> None:
    slots = (ctypes.c_uint32 * 4)(0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF)  # EEPROM as it comes
    following = (ctypes.c_uint32 * 2)()
    for boot in range(1, 9):
        which = logic.boot_next(slots, following) & 0xFF
        assert following[0] == boot
        broken = (ctypes.c_uint32 * 4)(*slots)
        broken[2 * which] = 12345  # power failed before its inverse was written
        logic.boot_next(broken, (ctypes.c_uint32 * 2).from_buffer(following))
        assert following[0] == boot
        slots[2 * which], slots[2 * which + 1] = following


def test_fuzzed_frames_and_coverage_guided_inputs_under_the_sanitizers(build: Path) -> None:
    """The long form is that of `make -C hw/firmware test`: 300 000 frames and 100 000 inputs."""
    need("make", "gcc")
    make("fuzz", build)
    amounts = ("300000", "100000") if LONG else ("50000", "15000")
    for program, amount, said in zip(("fuzz", "coverage_fuzz"), amounts, ("frames", "inputs"), strict=True):
        done = subprocess.run([str(build / program), amount], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert re.search(rf"{amount} {said}, .*\b\d{{4,}} pulses", done.stdout), done.stdout

"""The output "line ready": high only while a board that came would be filmed; low on every failure."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from tests.hw.emulated.chip import Chip
from tests.hw.emulated.line import HZ, Line, ms, us
from tests.hw.test_logic import LIGHT, RULE, talk
from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.controller.protocol import (
    PERMIT_TEST,
    Event,
    Hold,
    Kind,
    Nak,
    Reason,
    Request,
    Status,
    Suppressed,
    Type,
    arm,
    config_crc,
    configuration,
    ready,
)

GAPPED = replace(RULE, min_gap=ms(300), debounce=ms(2))
LONGEST_MS = 1000
PIN = "PC0"


class Interlock(RuleBasedStateMachine):
    """Boards, bounces, arming and statements of the host in any order and at any time."""

    logic: ctypes.CDLL

    def __init__(self) -> None:
        super().__init__()
        self.now = 0
        self.blocked = False
        self.stated_until = -1
        """Tick until which the newest statement is valid."""
        self.permit = 1
        self.was_high = False
        self.fell: int | None = None

    @initialize(armed=st.booleans())
    def power_up(self, armed: bool) -> None:
        self.logic.bridge_start(0)
        self.talk(configuration(GAPPED, LIGHT))
        if armed:
            self.arm()

    def talk(self, requests: list[Request]) -> None:
        talk(self.logic, requests, self.now)

    def high(self) -> bool:
        high = bool(self.logic.chip_ready() & 0xFF)
        if high and not self.was_high and self.fell is not None:
            assert self.now - self.fell >= ms(49), "it was low for less than 50 ms"
        if self.was_high and not high:
            self.fell = self.now
        self.was_high = high
        return high

    def events(self) -> list[Event]:
        struct, events = ctypes.create_string_buffer(16), []
        while self.logic.bridge_event(struct) & 0xFF:
            events.append(Event.unpack(struct.raw))
        return events

    def edge(self, blocked: bool) -> None:
        self.blocked = blocked
        self.logic.bridge_edge(ctypes.c_uint32(self.now), int(blocked))

    @rule(time_ms=st.sampled_from([1, 3, 20, 60, 300, 1100]))
    def wait(self, time_ms: int) -> None:
        for _ in range(time_ms):
            self.now += ms(1)
            self.logic.bridge_poll(ctypes.c_uint32(self.now))
            assert not self.high() or self.now < self.stated_until
        self.talk([Request(Type.BEAT)])

    @rule(hold_ms=st.sampled_from([0, 1, 200, 1000, 1001]), new=st.booleans())
    def state(self, hold_ms: int, new: bool) -> None:
        self.permit += new
        self.talk([ready(self.permit, hold_ms)])
        if hold_ms <= LONGEST_MS:
            self.stated_until = self.now + ms(hold_ms)

    @rule()
    def arm(self) -> None:
        self.talk([arm(1, config_crc(GAPPED, LIGHT))])

    @rule(request=st.sampled_from([Type.DISARM, Type.SAFE]))
    def stop(self, request: Type) -> None:
        self.talk([Request(request)])
        assert not self.high(), "at once, without another turn of the main loop"

    @precondition(lambda self: not self.blocked)
    @rule()
    def bounce(self) -> None:
        self.edge(True)
        self.now += us(300)
        self.logic.bridge_poll(ctypes.c_uint32(self.now))
        assert not self.high()
        self.edge(False)

    @precondition(lambda self: not self.blocked)
    @rule()
    def board_comes(self) -> None:
        """A board for which the output was high is filmed: its run begins."""
        self.events()
        permitted = self.high()
        self.edge(True)
        assert not self.high(), "in the same turn"
        for _ in range(20):
            self.now += us(500)
            self.logic.bridge_poll(ctypes.c_uint32(self.now))
        seen = self.events()
        if permitted:
            assert (Kind.BARRIER, 1) in [(e.kind, e.detail) for e in seen], seen
            assert Suppressed.GAP not in [e.detail for e in seen if e.kind == Kind.SUPPRESSED]

    @precondition(lambda self: self.blocked)
    @rule(new=st.booleans())
    def board_leaves(self, new: bool) -> None:
        """Often the run ends then, and the host permits the next board at once."""
        self.edge(False)
        if new:
            self.wait(60)
            self.state(1000, True)

    @invariant()
    def low_while_blocked_or_unpermitted(self) -> None:
        assert not self.high() or (not self.blocked and self.now < self.stated_until)


def test_never_ready_while_a_board_that_came_would_be_missed(logic: ctypes.CDLL) -> None:
    logic.chip_ready.restype = ctypes.c_uint8
    machine = type("Machine", (Interlock,), {"logic": logic})
    run_state_machine_as_test(machine, settings=settings(max_examples=30, stateful_step_count=25, deadline=None))


def armed_logic(logic: ctypes.CDLL) -> None:
    logic.bridge_start(0)
    talk(logic, [*configuration(GAPPED, LIGHT), arm(1, config_crc(GAPPED, LIGHT))])


def state_permit(logic: ctypes.CDLL, permit: int, hold_ms: int, now: int) -> Status:
    (reply,) = talk(logic, [ready(permit, hold_ms)], now)
    return Status.unpack(reply.payload)


def pass_time(logic: ctypes.CDLL, now: int, until: int) -> int:
    for tick in range(now, until, us(500)):
        logic.bridge_poll(ctypes.c_uint32(tick))
    return until


def test_a_permit_is_for_one_board_and_the_reply_says_why_the_output_is_low(logic: ctypes.CDLL) -> None:
    armed_logic(logic)
    assert state_permit(logic, 1, 1000, 0).ready == 1
    logic.bridge_edge(ctypes.c_uint32(ms(1)), 1)
    now = pass_time(logic, ms(1), ms(10))
    assert state_permit(logic, 1, 1000, now).hold == Hold.STATE
    assert state_permit(logic, 2, 1000, now).hold == Hold.STATE
    logic.bridge_edge(ctypes.c_uint32(now), 0)
    now = pass_time(logic, now, ms(300))
    assert state_permit(logic, 1, 1000, now).hold == Hold.GAP
    now = pass_time(logic, now, ms(320))
    assert state_permit(logic, 2, 1000, now).hold == Hold.SPENT, "it was stated before the end of the run was known"
    assert state_permit(logic, 3, 1000, now).hold == Hold.GAP, "it was high until a moment ago"
    now = pass_time(logic, now, ms(380))
    assert state_permit(logic, 3, 1000, now).hold == Hold.NONE
    assert state_permit(logic, 3, 0, now).hold == Hold.HOST
    logic.bridge_edge(ctypes.c_uint32(now), 1)
    assert state_permit(logic, 4, 1000, now).hold == Hold.BARRIER


def test_a_test_sets_the_output_only_while_idle(logic: ctypes.CDLL) -> None:
    logic.bridge_start(0)
    assert state_permit(logic, PERMIT_TEST, 500, 0).ready == 1
    talk(logic, [*configuration(GAPPED, LIGHT), arm(1, config_crc(GAPPED, LIGHT))])
    assert not logic.chip_ready() & 0xFF
    (reply,) = talk(logic, [ready(PERMIT_TEST, 500)])
    assert Nak.unpack(reply.payload) == Nak(Type.READY, Reason.STATE, 0, 1)


def test_no_statement_lasts_longer_than_a_second(logic: ctypes.CDLL) -> None:
    armed_logic(logic)
    (reply,) = talk(logic, [ready(1, LONGEST_MS + 1)])
    assert Nak.unpack(reply.payload) == Nak(Type.READY, Reason.RANGE, 0, LONGEST_MS)
    assert not logic.chip_ready() & 0xFF


# --- the firmware's binary on the emulated chip


def permitted(chip: Chip, *, lasting_s: float = 60.0) -> Line:
    """An armed line whose host permits a board."""
    line = Line(chip)
    line.link.ready_longest_ms = LONGEST_MS
    line.arm()
    assert not chip.rises(PIN), "armed is not permitted"
    line.link.permit = Permit(1, line.now_s + lasting_s)
    line.run(5)
    assert is_high(chip)
    return line


def is_high(chip: Chip) -> bool:
    return next((level for _, pin, level in reversed(chip.edges) if pin == PIN), 0) == 1


def fall(chip: Chip) -> int:
    """The cycle at which the output fell last."""
    return next(cycle for cycle, pin, level in reversed(chip.edges) if pin == PIN and not level)


def test_it_is_low_from_power_up_until_it_is_permitted(chip: Chip) -> None:
    line = Line(chip)
    line.link.ready_longest_ms = LONGEST_MS
    line.link.permit = Permit(1, 60.0)
    line.run(600)
    assert line.status().hold == Hold.STATE
    assert not chip.rises(PIN)


def test_a_board_lowers_it_within_microseconds_and_it_rises_for_the_next_permit(chip: Chip) -> None:
    line = permitted(chip)
    edge = line.barrier(True)
    line.run(60)
    assert 0 < fall(chip) - edge <= 16 * 20, "20 µs"
    line.barrier(False)
    line.run(400)
    assert not is_high(chip)
    assert line.status().hold == Hold.SPENT
    line.link.permit = Permit(2, line.now_s + 60.0)
    line.run(3)
    assert is_high(chip)


def test_it_stays_low_for_50_ms_at_least(chip: Chip) -> None:
    """A neighbour by SMEMA takes a shorter opening for none. Here the host withdraws a permit and gives another."""
    line = permitted(chip)
    line.link.permit = None
    line.run(5)
    fell = fall(chip)
    line.link.permit = Permit(2, line.now_s + 60.0)
    line.run(20)
    assert line.status().hold == Hold.GAP
    line.run(60)
    assert 0.05 * HZ <= chip.rises(PIN)[-1] - fell < 0.052 * HZ


def test_a_permit_runs_out_at_its_time_and_the_host_withdraws_one(chip: Chip) -> None:
    """The link renews a permit, but never beyond the time until which the station gave it."""
    line = permitted(chip, lasting_s=0.6)
    given = chip.cycle - round(0.005 * HZ)
    line.run(700)
    assert abs(fall(chip) - given - 0.6 * HZ) < 0.01 * HZ
    line.link.permit = Permit(2, line.now_s + 60.0)
    line.run(5)
    assert is_high(chip)
    line.link.permit = None
    withdrawn = chip.cycle
    line.run(5)
    assert 0 <= fall(chip) - withdrawn < 0.005 * HZ


def test_a_host_that_is_gone_lowers_it_within_a_second(chip: Chip) -> None:
    line = permitted(chip)
    line.run(300)
    gone = chip.cycle
    chip.run_ms(1100)
    assert 0.7 * HZ < fall(chip) - gone < 1.0 * HZ


@pytest.mark.parametrize("command", ["reset external", "reset power", "hang", "deaf"])
def test_a_reset_lowers_it(chip: Chip, command: str) -> None:
    """A reset makes the pin an input, which the pull-down draws low; the watchdog resets a firmware that hangs."""
    line = permitted(chip)
    line.link.permit = None
    before = chip.cycle
    chip.do(command)
    chip.run_ms(400)
    assert chip.resets
    assert chip.resets[-1] - before < 0.3 * HZ
    assert not is_high(chip)
    assert len(chip.rises(PIN)) == 1


def test_noise_on_the_line_never_raises_it(chip: Chip) -> None:
    line = Line(chip)
    line.arm()
    chip.do("noise 0.02 0.02 7")
    line.run(1500)
    assert not chip.rises(PIN)
    assert line.link.bad_frames

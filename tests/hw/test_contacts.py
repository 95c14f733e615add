"""The contacts of IPC-SMEMA-9851 beside "line ready", pin by pin on the emulated chip."""

from __future__ import annotations

import ctypes
import time
from dataclasses import replace

import pytest

from tests.hw.emulated.chip import Chip
from tests.hw.emulated.host import PLAN, Host
from tests.hw.emulated.line import HZ, Line
from tests.hw.emulated.paced import PacedChip
from tests.hw.emulated.vectors import IDENT
from tests.hw.test_logic import talk
from vaoi_station.acquisition.controller.interface import BarrierBlocked, BoardOffer, Contacts, ContactsChanged
from vaoi_station.acquisition.controller.protocol import (
    Kind,
    Nak,
    Reason,
    Request,
    Type,
    check_contacts,
    check_interlock,
    contacts_of,
    offer,
)
from vaoi_station.errors import DeviceError

AVAILABLE, FAILED, NEXT_READY = "PC3", "PC4", "PC5"
OFFERED, OFFERED_FAILED = "PC1", "PC2"
CLOSED, OPEN = 0, 1
GOOD = BoardOffer(1, failed=False, until_s=60.0, exit_s=(0.1, 0.4))


@pytest.fixture
def line(chip: Chip) -> Line:
    line = Line(chip)
    line.link.ready_longest_ms, line.link.contacts = 1000, True
    line.run(20)
    return line


def switch(line: Line, pin: str, level: int, turns: int = 15) -> None:
    line.chip.do(f"pin {pin} {level}")
    line.run(turns)


def is_closed(line: Line, pin: str) -> bool:
    return next((level for _, name, level in reversed(line.chip.edges) if name == pin), 0) == 1


def falls(line: Line, pin: str) -> list[int]:
    return [cycle for cycle, name, level in line.chip.edges if name == pin and not level]


def changes(line: Line) -> list[Contacts]:
    return [contacts_of(event.detail, event.index) for event in line.events(Kind.CONTACTS)]


def give(line: Line, offered: BoardOffer | None, turns: int = 5) -> None:
    line.link.offer = offered
    line.run(turns)


def test_each_input_is_reported_when_it_has_lasted(line: Line) -> None:
    for pin in (AVAILABLE, FAILED, NEXT_READY):
        switch(line, pin, CLOSED)
    for pin in (AVAILABLE, FAILED, NEXT_READY):
        switch(line, pin, OPEN)
    ins = [(c.available, c.failed, c.next_ready) for c in changes(line)]
    assert ins == [
        (False, False, False), (True, False, False), (True, True, False), (True, True, True),
        (False, True, True), (False, False, True), (False, False, False),
    ]  # fmt: skip


def test_a_glitch_is_not_reported(line: Line) -> None:
    """Relays bounce: what does not last for 10 ms counts neither as closed nor as open."""
    before = len(changes(line))
    switch(line, AVAILABLE, CLOSED, turns=6)
    switch(line, AVAILABLE, OPEN)
    assert len(changes(line)) == before
    switch(line, AVAILABLE, CLOSED)
    switch(line, AVAILABLE, OPEN, turns=6)
    switch(line, AVAILABLE, CLOSED)
    assert len(changes(line)) == before + 1


def test_contacts_are_reported_only_to_a_host_that_asks(chip: Chip) -> None:
    """A host of 1.3 gets no event that it does not know."""
    line = Line(chip)
    line.run(5)
    switch(line, AVAILABLE, CLOSED)
    assert not line.events(Kind.CONTACTS)
    assert line.status().closed.available


def test_a_host_that_starts_again_gets_the_present_levels(line: Line) -> None:
    switch(line, FAILED, CLOSED)
    before = len(changes(line))
    line.request(offer(None, 0))
    line.run(3)
    assert changes(line)[before:] == [Contacts(failed=True)]


def test_a_board_is_offered_until_the_next_machine_has_taken_it(line: Line) -> None:
    give(line, GOOD)
    assert is_closed(line, OFFERED)
    assert not is_closed(line, OFFERED_FAILED)
    switch(line, NEXT_READY, CLOSED, turns=200)
    assert is_closed(line, OFFERED)
    switch(line, NEXT_READY, OPEN)
    assert not is_closed(line, OFFERED)
    assert line.status().taken == 1
    line.run(300)
    assert not is_closed(line, OFFERED), "the host still offers it, but it has left"


def test_a_failed_board_closes_the_other_contact(line: Line) -> None:
    give(line, replace(GOOD, failed=True))
    assert is_closed(line, OFFERED_FAILED)
    assert not line.chip.rises(OFFERED)


def test_a_board_that_turns_out_bad_shows_by_an_opening(line: Line) -> None:
    give(line, GOOD)
    give(line, replace(GOOD, failed=True), turns=60)
    assert 0.05 * HZ <= line.chip.rises(OFFERED_FAILED)[0] - falls(line, OFFERED)[0] < 0.052 * HZ


def test_a_machine_that_withdraws_has_taken_nothing(line: Line) -> None:
    give(line, GOOD)
    switch(line, NEXT_READY, CLOSED, turns=50)
    switch(line, NEXT_READY, OPEN)
    assert is_closed(line, OFFERED)
    assert line.status().taken == 0


def test_a_machine_that_stays_ready_has_taken_the_board_after_the_longest_time(line: Line) -> None:
    switch(line, NEXT_READY, CLOSED)
    give(line, GOOD)
    closed = line.chip.rises(OFFERED)[0]
    line.run(450)
    assert abs(falls(line, OFFERED)[0] - closed - 0.4 * HZ) < 0.002 * HZ


def test_two_boards_are_50_ms_apart(line: Line) -> None:
    switch(line, NEXT_READY, CLOSED)
    give(line, GOOD, turns=420)
    (fell,) = falls(line, OFFERED)
    give(line, replace(GOOD, number=2, failed=True), turns=60)
    assert not is_closed(line, OFFERED)
    assert 0.05 * HZ <= line.chip.rises(OFFERED_FAILED)[0] - fell < 0.08 * HZ
    give(line, replace(GOOD, number=3), turns=5)
    assert not is_closed(line, OFFERED), "another board replaces it: at once open, and for 50 ms"
    assert not is_closed(line, OFFERED_FAILED)
    line.run(60)
    assert line.chip.rises(OFFERED)[-1] - falls(line, OFFERED_FAILED)[-1] >= 0.05 * HZ


def test_a_host_that_is_gone_opens_them_within_a_second_and_a_board_taken_meanwhile_is_not_offered_again(
    line: Line,
) -> None:
    give(line, replace(GOOD, exit_s=(0.1, 30.0)), turns=300)
    switch(line, NEXT_READY, CLOSED)
    gone = line.chip.cycle
    line.chip.run_ms(1100)
    assert 0.7 * HZ < falls(line, OFFERED)[0] - gone < 1.0 * HZ
    switch(line, NEXT_READY, OPEN, turns=100)
    assert not is_closed(line, OFFERED)
    assert line.status().taken == 1


@pytest.mark.parametrize("command", ["reset external", "reset power", "hang", "deaf"])
def test_a_reset_opens_them(line: Line, command: str) -> None:
    """A reset makes the pins inputs, which the pull-downs draw low; the watchdog resets a firmware that hangs."""
    give(line, GOOD)
    line.link.offer = None
    line.chip.do(command)
    line.chip.run_ms(400)
    assert line.chip.resets
    assert not is_closed(line, OFFERED)


def test_the_levels_are_reported_again_after_a_reset(line: Line) -> None:
    switch(line, AVAILABLE, CLOSED)
    line.chip.do("reset external")
    line.run(400)
    assert line.restarts()
    assert changes(line)[-1].available


def test_after_a_reset_the_board_that_was_taken_is_offered_again_and_no_board_counts_as_taken(line: Line) -> None:
    """The station sees by this that it does not know which board is the first (`LineContacts.controller_reset`)."""
    give(line, GOOD)
    switch(line, NEXT_READY, CLOSED, 120)
    switch(line, NEXT_READY, OPEN)
    assert changes(line)[-1].taken == GOOD.number
    line.chip.do("reset external")
    line.run(400)
    assert line.restarts()
    assert is_closed(line, OFFERED)
    assert changes(line)[-1].taken == 0


def test_the_safe_state_opens_them(line: Line) -> None:
    give(line, GOOD)
    line.request(Request(Type.SAFE))
    assert not is_closed(line, OFFERED)
    line.request(Request(Type.DISARM))
    line.run(60)
    assert is_closed(line, OFFERED)


def test_an_offer_out_of_range_is_refused(logic: ctypes.CDLL) -> None:
    logic.bridge_start(0)
    wrong = [offer(GOOD, 1001), Request(Type.OFFER, bytes.fromhex("01000001010000000000"))]
    wrong.append(offer(replace(GOOD, exit_s=(2.0, 1.0)), 1000))
    naks = [Nak.unpack(message.payload) for message in talk(logic, wrong)]
    assert [(nak.reason, nak.field, nak.limit) for nak in naks] == [
        (Reason.RANGE, 0, 1000), (Reason.RANGE, 1, 0x30), (Reason.RANGE, 2, 1000),
    ]  # fmt: skip


# --- the station's controller on the chip at the pace of the clock


def test_the_station_gets_changes_in_their_order_and_offers_a_board(paced: PacedChip) -> None:
    host = Host(paced, contacts=True)
    try:
        assert host.next(ContactsChanged).contacts == Contacts()
        host.controller.arm(PLAN)
        paced.do("pin PC4 0")
        assert host.next(ContactsChanged).contacts.failed
        paced.do("pin PB0 1")
        host.next(BarrierBlocked)
        host.controller.offer_board(replace(GOOD, until_s=time.monotonic() + 60.0, exit_s=(0.0, 30.0)))
        assert host.next(ContactsChanged).contacts.offered
        paced.do("pin PC5 0")
        paced.rest(100)
        paced.do("pin PC5 1")
        while host.next(ContactsChanged).contacts.taken != GOOD.number:
            pass
        assert "contacts closed: failed board available" in host.controller.health()
    finally:
        host.controller.close()


def test_firmware_without_contacts_is_refused_only_if_they_are_used() -> None:
    before = replace(IDENT, minor=3)
    check_interlock(before)
    with pytest.raises(DeviceError, match="no contacts for IPC-SMEMA-9851"):
        check_contacts(before)

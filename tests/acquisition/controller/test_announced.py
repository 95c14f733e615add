"""What contacts of the machine upstream say of a board, by the order in which they change and boards come."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.announced import AnnouncedBoards, Came
from vaoi_station.acquisition.controller.interface import BarrierBlocked, Contacts, ContactsChanged

OPEN, GOOD, BAD, BOTH = Contacts(), Contacts(available=True), Contacts(failed=True), Contacts(True, True)
B, LATER = "board", "later"
LONGEST_S = 30.0
BEGUN = OPEN, LATER
"""The controller reports, and since then no board can have been on its way before."""


class Line:
    """What the controller reports of a line."""

    def __init__(self) -> None:
        self.boards, self.at_s = AnnouncedBoards(LONGEST_S), 0.0

    def change(self, contacts: Contacts, after_s: float = 0.1) -> None:
        self.at_s += after_s
        self.boards.follow(ContactsChanged(0, self.at_s, contacts))

    def comes(self, after_s: float = 0.1) -> Came | None:
        self.at_s += after_s
        self.boards.follow(BarrierBlocked(0, self.at_s))
        return self.boards.take_came()


def play(*steps: Contacts | str) -> list[Came | None]:
    """Let the contacts change and boards come; return how each board came."""
    line, came = Line(), []
    for step in steps:
        if isinstance(step, Contacts):
            line.change(step)
        elif step == B:
            came.append(line.comes())
        elif step == LATER:
            line.at_s += LONGEST_S
        else:
            line.boards.lose(step)
    return came


@pytest.mark.parametrize(
    ("steps", "came"),
    [
        ((B,), ["failed"]),
        ((OPEN, B), ["failed"]),
        ((OPEN, GOOD, OPEN, B, LATER, B), ["failed", "by-hand"]),
        ((*BEGUN, B), ["by-hand"]),
        ((*BEGUN, GOOD, OPEN, B, B), ["announced", "by-hand"]),
        ((*BEGUN, GOOD, B, OPEN, GOOD, B), ["announced", "announced"]),
        ((*BEGUN, BAD, OPEN, B), ["failed"]),
        ((*BEGUN, BAD, OPEN, B, B, GOOD, OPEN, B, B), ["failed", "failed", "announced", "by-hand"]),
        ((*BEGUN, GOOD, BOTH, GOOD, OPEN, B), ["failed"]),
        ((*BEGUN, BAD, B, OPEN, GOOD, OPEN, B), ["failed", "announced"]),
        ((*BEGUN, GOOD, B, B), ["announced", "announced"]),
        ((*BEGUN, BAD, B, B), ["failed", "failed"]),
    ],
)
def test_a_board_is_what_was_announced_before_it_came(steps: tuple[Contacts | str, ...], came: list[Came]) -> None:
    assert play(*steps) == came


def test_without_contacts_nothing_is_said_of_a_board() -> None:
    assert AnnouncedBoards(LONGEST_S, wired=False).take_came() is None


def test_of_two_boards_on_their_way_both_are_failed_if_one_is() -> None:
    """It is not known which of them comes first, nor whether one was taken off."""
    assert play(*BEGUN, GOOD, OPEN, BAD, OPEN, B, B, GOOD, B) == ["failed", "failed", "announced"]
    assert play(*BEGUN, BAD, OPEN, GOOD, OPEN, B, B, GOOD, B) == ["failed", "failed", "announced"]


def test_an_opening_of_less_than_50_ms_belongs_to_one_board() -> None:
    line = Line()
    for after_s, contacts in ((0.0, OPEN), (40.0, BOTH), (0.2, OPEN), (0.03, GOOD), (1.0, OPEN)):
        line.change(contacts, after_s)
    assert line.comes() == "failed"
    line.change(GOOD, 0.2)
    line.change(OPEN)
    assert [line.comes(), line.comes()] == ["announced", "by-hand"]


@pytest.mark.parametrize("code", ["events-lost", "controller-reset"])
def test_boards_that_may_have_been_on_their_way_when_changes_were_lost_count_as_failed(code: str) -> None:
    assert play(*BEGUN, code, B, GOOD, B, OPEN, LATER, GOOD, OPEN, B, LATER, B) == [
        "failed", "failed", "announced", "by-hand",
    ]  # fmt: skip
    assert play(*BEGUN, "encoder-silent", B) == ["by-hand"]


def test_a_failed_board_that_was_taken_off_makes_others_failed_only_until_it_would_have_come() -> None:
    line = Line()
    line.change(OPEN)
    line.change(BAD, LONGEST_S)
    line.change(OPEN)
    came = []
    for _ in range(5):
        line.change(GOOD, 8.0)
        line.change(OPEN, 0.5)
        came.append(line.comes(0.5))
    assert came == ["failed", "failed", "failed", "announced", "announced"]


STEPS = st.lists(st.sampled_from(["good", "bad", "bad unseen", "comes", "taken off", "by hand"]), max_size=40)


@given(st.lists(st.booleans(), max_size=3), STEPS)
def test_a_bad_board_never_counts_as_good(there: list[bool], steps: list[str]) -> None:
    """Boards keep their order on the belt. What a person does with them is not seen, and changes may be lost.

    Two cases cannot be distinguished, and are left out: a board that is put in by hand takes the announcement of the
    one behind it, so that another announcement could be taken for that one; and several boards whose changes were lost.
    """
    line, belt = Line(), deque(there)  # `there`: those on their way when the process begins
    line.change(OPEN)
    swapped, unseen = False, bool(there)
    for step in steps:
        if not belt:
            swapped = unseen = False
        if step in ("good", "bad") and not swapped:
            line.change(BAD if step == "bad" else GOOD)
            line.change(OPEN)
            belt.append(step == "bad")
        elif step == "bad unseen" and not (swapped or unseen):
            line.boards.lose("events-lost")
            belt.append(unseen := True)
        elif step == "taken off" and belt:
            belt.popleft()
        elif step == "by hand" and len(belt) <= 1 and not unseen:
            swapped = bool(belt)
            assert line.comes() is not None
        elif step == "comes" and belt:
            bad = belt.popleft()
            assert line.comes() == "failed" or not bad

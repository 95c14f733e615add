"""What contacts of the machine upstream say of a board, by the order in which they change and boards come."""

from __future__ import annotations

from itertools import count

import pytest

from vaoi_station.acquisition.controller.announced import AnnouncedBoards, Came
from vaoi_station.acquisition.controller.interface import Contacts

OPEN, GOOD, BAD, BOTH = Contacts(), Contacts(available=True), Contacts(failed=True), Contacts(True, True)
B = "board"


def play(*steps: Contacts | str) -> list[Came | None]:
    """Let the contacts change, 100 ms apart, and boards come; return how each board came."""
    boards, came = AnnouncedBoards(), []
    for at_s, step in zip(count(1.0, 0.1), steps, strict=False):
        if isinstance(step, Contacts):
            boards.change(step, at_s)
        elif step == B:
            came.append(boards.arrive())
        elif step == "arm":
            boards.forget()
        else:
            boards.lose(step)
    return came


@pytest.mark.parametrize(
    ("steps", "came"),
    [
        ((B,), [None]),
        ((OPEN, B), ["by-hand"]),
        ((OPEN, GOOD, OPEN, B, B), ["announced", "by-hand"]),
        ((OPEN, GOOD, B, OPEN, GOOD, B), ["announced", "announced"]),
        ((OPEN, BAD, OPEN, B), ["failed"]),
        ((OPEN, GOOD, BOTH, GOOD, OPEN, B), ["failed"]),
        ((OPEN, BAD, B, OPEN, GOOD, OPEN, B), ["failed", "announced"]),
        ((GOOD, B, B), ["announced", "announced"]),
        ((BAD, B, B), ["failed", "failed"]),
    ],
)
def test_a_board_is_what_was_announced_before_it_came(steps: tuple[Contacts | str, ...], came: list[Came]) -> None:
    assert play(*steps) == came


def test_of_two_boards_on_their_way_both_are_failed_if_one_is() -> None:
    """It is not known which of them comes first, nor whether one was taken off."""
    assert play(OPEN, GOOD, OPEN, BAD, OPEN, B, B, GOOD, B) == ["failed", "failed", "announced"]
    assert play(OPEN, BAD, OPEN, GOOD, OPEN, B, B, GOOD, B) == ["failed", "failed", "announced"]


def test_an_opening_of_less_than_50_ms_belongs_to_one_board() -> None:
    boards = AnnouncedBoards()
    for time_s, contacts in ((0.0, OPEN), (1.0, GOOD), (1.2, OPEN), (1.23, GOOD), (2.0, OPEN)):
        boards.change(contacts, time_s)
    assert [boards.arrive(), boards.arrive()] == ["announced", "by-hand"]


@pytest.mark.parametrize("code", ["events-lost", "controller-reset"])
def test_a_board_after_lost_changes_counts_as_failed(code: str) -> None:
    assert play(OPEN, code, B, GOOD, B) == ["failed", "announced"]
    assert play(OPEN, "encoder-silent", B) == ["by-hand"]


def test_an_arming_forgets_good_boards_only() -> None:
    assert play(OPEN, GOOD, OPEN, "arm", B) == ["by-hand"]
    assert play(OPEN, GOOD, "arm", B) == ["announced"]
    assert play(OPEN, BAD, OPEN, "arm", B) == ["failed"]

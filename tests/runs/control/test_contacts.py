"""Boards by the contacts of the neighbours: how they came, and what the next machine is offered."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from tests.runs.conftest import a_stitch
from tests.runs.peer import PATIENCE_S
from vaoi_station.acquisition.controller.announced import Came
from vaoi_station.acquisition.controller.interface import BoardOffer, Contacts
from vaoi_station.acquisition.process import messages
from vaoi_station.acquisition.process.messages import OfferBoard
from vaoi_station.errors import StateError
from vaoi_station.line_config import Smema
from vaoi_station.model import Reason, Status
from vaoi_station.runs.control.contacts import LineContacts
from vaoi_station.runs.run.order_queue import LineBoard
from vaoi_station.runs.states.schemas import ContactsStatus
from vaoi_station.store import Store
from vaoi_station.store.documents import KeyedTexts

BOTH = Smema(sides="both", exit_s=(0.5, 9.0), places=2)


class Bench:
    """The boards of a line, and the newest offer."""

    def __init__(self, config: Smema | None = BOTH, documents: KeyedTexts | None = None) -> None:
        self.offers: list[BoardOffer | None] = []
        self.said: list[str] = []
        self.now_s, self.taken = 0.0, 1
        publish = lambda *_, code, **__: self.said.append(code)  # noqa: E731
        self.contacts = LineContacts(config, self._send, publish, documents)

    def _send(self, command: OfferBoard) -> None:
        self.offers.append(command.offer)

    def film(self, run: str, came: Came | None = "announced", *, failed: bool = False) -> None:
        self.contacts.began(run, came)
        self.contacts.ended(run, failed=failed)

    def turn(self, taken: int | None = None) -> BoardOffer | None:
        """Let a moment pass, and the controller state which board was taken last; return the newest offer."""
        self.now_s += 0.3
        self.taken = self.taken if taken is None else taken
        self.contacts.update(Contacts(taken=self.taken), self.now_s)
        return self.offers[-1] if self.offers else None

    def take(self) -> bool:
        """Let the next machine take what is offered; return whether it was offered as failed."""
        offer = self.turn()
        assert offer is not None
        self.turn(offer.number)
        return offer.failed


def test_a_board_is_offered_when_its_run_has_ended_and_renewed_until_it_is_taken() -> None:
    bench = Bench()
    bench.contacts.began("r1", "announced")
    assert bench.turn() is None
    bench.contacts.ended("r1", failed=False)
    first = bench.turn()
    assert first is not None
    assert (first.failed, first.exit_s) == (False, (0.5, 9.0))
    again = bench.turn()
    assert again is not None
    assert (again.number, again.until_s > first.until_s) == (first.number, True)
    bench.turn(first.number)
    bench.turn(first.number)
    assert len(bench.offers) == 2
    status = status_of(bench)
    assert (status.known, status.boards) == (False, ())


def test_boards_leave_in_their_order_each_with_a_number_of_its_own() -> None:
    bench = Bench()
    bench.contacts.began("r1", "failed")
    bench.film("r2")
    assert bench.turn() is None, "the first is not ready"
    bench.contacts.ended("r1", failed=False)
    assert [bench.take(), bench.take()] == [True, False]
    assert len({offer.number for offer in bench.offers if offer}) == 2


def test_what_is_not_known_to_be_good_leaves_as_failed() -> None:
    bench = Bench(BOTH.model_copy(update={"places": 9}))
    bench.film("r1", failed=True)
    bench.film("r2", "by-hand")
    bench.contacts.missed(1, None)
    bench.film("r3")
    bench.contacts.missed(1, "r2")
    assert [bench.take() for _ in range(5)] == [True, False, True, True, False]
    assert bench.said == ["board-by-hand"]


def test_a_full_place_behind_the_cameras_holds_boards_back() -> None:
    bench = Bench()
    bench.film("r1")
    assert bench.contacts.held() == ()
    bench.film("r2")
    assert [reason.code for reason in bench.contacts.held()] == ["boards-wait"]
    bench.take()
    assert bench.contacts.held() == ()


def test_a_board_that_a_person_took_out_is_not_offered() -> None:
    bench = Bench()
    bench.film("r1")
    bench.film("r2", failed=True)
    before = bench.turn()
    bench.contacts.remove("r1")
    after = bench.turn()
    assert before is not None
    assert after is not None
    assert (after.failed, after.number != before.number) == (True, True)
    with pytest.raises(StateError, match="does not wait"):
        bench.contacts.remove("r1")


def written(store: Store) -> None:
    """Wait for what is being written."""
    store.standing.set("another", "").result(PATIENCE_S)


def test_boards_behind_the_cameras_survive_a_restart_and_one_without_a_result_leaves_as_failed(store: Store) -> None:
    before = Bench(documents=store.standing)
    before.film("r0")
    before.take()
    before.film("r1")
    before.contacts.began("r2", "announced")
    before.turn()
    written(store)
    after = restarted(before, store)
    assert [after.take(), after.take()] == [False, True]
    written(store)
    assert restarted(after, store).turn() is None


def restarted(before: Bench, store: Store) -> Bench:
    after = Bench(documents=store.standing)
    after.taken = before.taken
    return after


def test_a_board_that_the_next_machine_took_during_a_restart_is_not_offered_again(store: Store) -> None:
    before = Bench(documents=store.standing)
    before.film("r1", failed=True)
    before.film("r2")
    offer = before.turn()
    written(store)
    after = restarted(before, store)
    after.contacts.update(None, 0.1)
    assert after.offers == [], "before it is known what was taken"
    assert offer is not None
    after.turn(offer.number)
    assert [board.name for board in status_of(after).boards] == ["r2"]
    assert not after.take()


def status_of(bench: Bench) -> ContactsStatus:
    status = bench.contacts.status(None)
    assert status is not None
    return status


@pytest.mark.parametrize("cause", ["reset", "taken", "power cut"])
def test_boards_leave_as_failed_until_none_is_there_if_one_may_have_left_unseen(store: Store, cause: str) -> None:
    bench = Bench(documents=store.standing)
    bench.film("r1")
    bench.film("r2")
    bench.turn()
    if cause == "reset":
        bench.contacts.controller_reset()
    elif cause == "power cut":
        written(store)
        bench = Bench(documents=store.standing)
    bench.turn(0)
    assert bench.said == ["board-between-machines"]
    bench.film("r3")
    assert [bench.take(), bench.take()] == [True, True]
    written(store)
    bench = restarted(bench, store)
    bench.film("r4")
    assert [bench.take(), bench.take()] == [True, True]
    bench.film("r5")
    assert not bench.take()


def test_no_board_gets_the_number_of_the_one_that_was_taken_last() -> None:
    bench = Bench()
    bench.film("r1")
    first = bench.turn()
    assert first is not None
    bench.contacts.remove("r1")
    bench.turn(taken := first.number % 0xFFFF + 1)
    bench.film("r2")
    second = bench.turn()
    assert second is not None
    assert second.number not in (first.number, taken)


def test_a_reset_while_nothing_is_on_offer_changes_nothing() -> None:
    bench = Bench()
    bench.contacts.began("r1", "announced")
    bench.turn()
    bench.contacts.controller_reset()
    bench.turn(0)
    bench.contacts.ended("r1", failed=False)
    assert not bench.take()


def test_of_more_boards_than_are_kept_all_leave_as_failed_and_none_for_another() -> None:
    bench = Bench()
    for n in range(22):
        bench.film(f"r{n}")
    bench.contacts.remove("r21")
    assert [bench.take() for _ in range(20)] == [True] * 20
    assert bench.said == ["boards-wait"] * 2
    bench.film("next")
    assert [bench.take(), bench.take()] == [True, False]


def test_boards_without_a_run_have_names_that_no_later_start_uses_again() -> None:
    names = set[str]()
    for bench in (Bench(), Bench()):
        bench.contacts.missed(1, None)
        names |= {board.name for board in status_of(bench).boards}
    assert len(names) == 2


def test_without_contacts_of_the_next_machine_nothing_is_offered_or_held() -> None:
    for config in (None, Smema(sides="upstream")):
        bench = Bench(config)
        bench.film("r1")
        bench.film("r2")
        assert (bench.turn(), bench.contacts.held()) == (None, ())
        assert bench.contacts.came_failed("") == (config is not None), "a board that was not filmed"


# --- on a station


@pytest.fixture
def line(make_rig: Callable[..., Any]) -> Any:
    rig = make_rig(lock="on", smema=BOTH)
    rig.ready()
    rig.peer.report(messages.Health((), "fine", time.monotonic() + 1e3, contacts=Contacts(next_ready=True)))
    rig.wait_for(lambda: rig.coordinator.contacts().known, "the contacts")
    return rig


def film(rig: Any, grant: messages.Grant, came: Came | None) -> Any:
    rig.peer.report(messages.RunStarted(grant.run, grant.bay, time.monotonic(), came=came))
    rig.finish(grant, [r for row in range(3) for r in rig.row(grant, row)])
    return rig.result_of(grant.run)


def offered(rig: Any) -> BoardOffer:
    """The next offer of a board; other commands are skipped."""
    while rig.peer.connection.poll(PATIENCE_S):
        command = rig.peer.connection.recv()
        if isinstance(command, OfferBoard) and command.offer is not None:
            return command.offer
    raise AssertionError("no board is offered")


def test_a_bad_board_is_a_good_run_and_leaves_as_a_bad_board(line: Any) -> None:
    run = film(line, line.arm(), "failed")
    assert (run.verdict, run.came) == (Status.OK, "failed")
    assert offered(line).failed
    assert line.coordinator.orders.came_failed(run.id)
    assert "board-came-failed" in [event.code for event in line.coordinator.events()]


def test_a_failed_result_makes_no_good_board(line: Any) -> None:
    line.workers.result = lambda head: a_stitch(head, Status.FAILED, ("no fiducial was found",))
    film(line, line.arm(), "announced")
    assert offered(line).failed


def test_a_bad_board_by_messages_is_one_for_contacts_too(line: Any) -> None:
    """Upstream speaks Hermes, the next machine has contacts."""
    grant = line.arm()
    orders = line.coordinator.orders
    line.coordinator._core.line.orders.queue.window_s = (0.0, 0.0)
    orders.by_messages(True)
    orders.announce(1, LineBoard("guid", failed="bad"))
    line.coordinator._core.line.orders.queue.window_s = (0.0, 30.0)
    orders.started(1)
    run = film(line, grant, None)
    assert run.came == "failed"
    assert offered(line).failed


def test_a_board_is_not_offered_before_its_run_is_announced(line: Any) -> None:
    core, announced = line.coordinator._core, list[tuple[str, float]]()
    line.archive.on_announced = lambda *of: announced.append(of)
    run = film(line, line.arm(), "announced").id
    assert line.coordinator.contacts().boards == ()
    line.coordinator._inbox.ask(lambda: core.announced(run, 0.0))
    assert [board.name for board in line.coordinator.contacts().boards] == [run]


def test_a_reset_of_the_controller_reaches_the_boards_on_offer(line: Any) -> None:
    film(line, line.arm(), "announced")
    assert not offered(line).failed
    line.peer.report(messages.Trouble("controller-reset", "It was reset.", ""))
    line.wait_for(lambda: line.coordinator.contacts().boards[0].failed, "the doubt")
    assert offered(line).failed


def test_a_full_place_behind_the_cameras_by_messages_holds_the_contact_upstream(line: Any) -> None:
    """Upstream has contacts, the next machine speaks Hermes."""
    line.arm()
    full = Reason(code="boards-wait", message="One board is in the station.", action="Wait.")
    core = line.coordinator._core
    line.coordinator._inbox.ask(lambda: setattr(core, "other_warnings", lambda: (full,)))
    snapshot = line.coordinator.snapshot()
    assert full in snapshot.line_held
    assert full not in snapshot.warnings
    line.coordinator._inbox.ask(lambda: setattr(core, "other_warnings", tuple))
    assert full not in line.coordinator.snapshot().line_held

"""The lane lets a board come only when it may, passes on what the line said of it, and never guesses where it is."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.hermes.station import GivenOrders
from vaoi_station.errors import NotFoundError
from vaoi_station.hermes.lane import Inside, Lane, Side
from vaoi_station.hermes.messages import Message, Parts
from vaoi_station.hermes.session import COMPLETE, INCOMPLETE, NOT_STARTED, Role, Session
from vaoi_station.line_config import Hermes
from vaoi_station.model import Reason
from vaoi_station.runs.run.order_queue import LineBoard

BUSY = Reason(code="line-filming", message="A board is being filmed.", action="Wait.")
ROLES: dict[Side, Role] = {"upstream": "receiver", "downstream": "sender"}
SUB_BOARDS: Parts = {"SubBoards": (("SB", {"Pos": "1", "St": "4"}),)}


class Played:
    """A lane with neighbours whose messages a test gives."""

    def __init__(self, **table: Any) -> None:
        config = Hermes(upstream="a", listen="b", products={"P-1": "relay"}, exit_s=2, **table)
        self.orders, self.events, self.supervised = GivenOrders(), list[str](), list[Message]()
        self.sent: dict[Side, list[Message]] = {"upstream": [], "downstream": []}
        self.lane = Lane(config, "station", 125.0, self.orders, self._send, self._publish, self.supervised.append)

    def _send(self, side: Side, message: Message) -> None:
        self.sent[side].append(self.lane.sessions[side].sent(message))

    def _publish(self, _kind: str, _message: str, *, code: str, **_more: Any) -> None:
        self.events.append(code)

    def connect(self, side: Side, now_s: float = 0.0) -> None:
        session = Session(ROLES[side], "station", 1, now_s)
        session.received(Message.of("ServiceDescription", MachineId="m", LaneId=1, Version="1.6"), now_s)
        self.lane.connected(side, session, now_s)

    def take(self, side: Side, tag: str, parts: Parts | None = None, now_s: float = 0.0, **values: str | int) -> None:
        answer = self.lane.sessions[side].received(Message.of(tag, parts or {}, **values), now_s)
        assert not answer.close
        if answer.news is not None:
            self.lane.received(side, answer.news, now_s)

    def available(self, board: str, parts: Parts | None = None, **values: str | int) -> None:
        known: dict[str, str | int] = {"BoardIdCreatedBy": "printer", "FailedBoard": 1, "FlippedBoard": 1}
        self.take("upstream", "BoardAvailable", parts, 0.0, BoardId=board, **(known | values))

    def comes_in(self, board: str, parts: Parts | None = None, **values: str | int) -> None:
        self.available(board, parts, **values)
        self.take("upstream", "TransportFinished", TransferState=COMPLETE, BoardId=board)

    def film(self, run: str) -> None:
        self.lane.run_began(run, 0.0)
        self.lane.run_ended(run, 0.0)

    def tags(self, side: Side) -> list[str]:
        return [message.tag for message in self.sent[side]]


@pytest.fixture
def played() -> Played:
    return Played()


def test_machine_ready_obeys_what_holds_the_line(played: Played) -> None:
    played.orders.held = (BUSY,)
    played.connect("upstream")
    assert played.tags("upstream") == []
    played.orders.held = ()
    played.lane.decide(1.0)
    played.orders.held = (BUSY,)
    played.lane.decide(2.0)
    assert played.tags("upstream") == ["MachineReady", "RevokeMachineReady"]
    assert played.lane.held == (BUSY,)


def test_a_board_is_not_started_while_the_line_is_held(played: Played) -> None:
    played.connect("upstream")
    played.orders.held = (BUSY,)
    played.available("b1")
    assert played.tags("upstream") == ["MachineReady", "RevokeMachineReady"]
    assert played.orders.calls == ["announce b1"]


def test_a_board_comes_in_and_its_product_names_its_board_type(played: Played) -> None:
    played.connect("upstream")
    played.comes_in("b1", ProductTypeId="P-1", TopBarcode="A7", FailedBoard=2, FlippedBoard=2)
    assert played.tags("upstream") == ["MachineReady", "StartTransport", "StopTransport", "MachineReady"]
    assert played.sent["upstream"][1].values == {"BoardId": "b1", "ConveyorSpeed": "125"}
    (board,) = played.orders.gap
    assert (board.board_type, board.barcodes, board.failed, board.side) == ("relay", ("A7",), "bad", "bottom")
    assert [m.tag for m in played.supervised] == ["BoardArrived"]


def test_what_the_line_says_of_a_board_travels_on(played: Played) -> None:
    for side in ROLES:
        played.connect(side)
    sizes: dict[str, str | int] = {"Length": "120.50", "WorkOrderId": "W9", "Route": 3, "TopBarcode": "A7"}
    played.comes_in("b1", SUB_BOARDS, FailedBoard=2, **sizes)
    played.film("run-1")
    offered = played.sent["downstream"][-1]
    assert (offered.tag, offered.parts) == ("BoardAvailable", SUB_BOARDS)
    expected = {"BoardId": "b1", "BoardIdCreatedBy": "printer", "FailedBoard": "2", "FlippedBoard": "1"}
    assert offered.values == {**expected, **{name: str(value) for name, value in sizes.items()}}


def test_a_board_that_no_message_announced_gets_an_id_of_the_station(played: Played) -> None:
    played.connect("downstream")
    played.film("run-1")
    offered = played.sent["downstream"][-1]
    assert (offered.get("BoardIdCreatedBy"), offered.get("FailedBoard")) == ("station", "0")
    again = Played()
    again.connect("downstream")
    again.film("run-1")
    assert again.sent["downstream"][-1].get("BoardId") == offered.get("BoardId")


def test_a_board_leaves_after_its_time_or_when_the_next_machine_has_it(played: Played) -> None:
    played.connect("downstream")
    for run, early in (("run-1", False), ("run-2", True)):
        played.film(run)
        board = played.lane.waiting[0].board_id
        played.take("downstream", "MachineReady", FailedBoard=0)
        played.take("downstream", "StartTransport", BoardId=board)
        if not early:
            played.lane.decide(1.9)
            assert played.tags("downstream")[-1] == "BoardAvailable"
            played.lane.decide(2.0)
        played.take("downstream", "StopTransport", BoardId=board, TransferState=COMPLETE)
        assert played.tags("downstream")[-1] == "TransportFinished"
        assert not played.lane.waiting
    assert [m.tag for m in played.supervised] == ["BoardArrived", "BoardDeparted"] * 2


def test_a_board_that_was_not_started_is_offered_again(played: Played) -> None:
    played.connect("downstream")
    played.film("run-1")
    board = played.lane.waiting[0].board_id
    played.take("downstream", "MachineReady", FailedBoard=0)
    played.take("downstream", "StartTransport", BoardId=board)
    played.take("downstream", "StopTransport", BoardId=board, TransferState=NOT_STARTED)
    assert played.tags("downstream")[-2:] == ["TransportFinished", "BoardAvailable"]


def _cut(played: Played, board: str) -> None:
    played.lane.lost("downstream", "cut", 1.0)
    played.connect("downstream", 2.0)


def _stop(played: Played, board: str) -> None:
    played.take("downstream", "StopTransport", BoardId=board, TransferState=INCOMPLETE)


@pytest.mark.parametrize("ends", [_cut, _stop])
def test_a_board_between_the_machines_holds_the_lane_until_a_person_has_looked(
    played: Played, ends: Callable[[Played, str], None]
) -> None:
    for side in ROLES:
        played.connect(side)
    played.film("run-1")
    board = played.lane.waiting[0].board_id
    played.take("downstream", "MachineReady", FailedBoard=0)
    played.take("downstream", "StartTransport", BoardId=board)
    ends(played, board)
    played.sent = {"upstream": [], "downstream": []}
    played.lane.run_ended(None, 3.0)
    assert played.tags("upstream") == played.tags("downstream") == []
    assert played.events == ["board-between-machines"]
    assert [reason.code for reason in played.lane.held] == ["board-between-machines"]
    assert played.lane.remove(board, 4.0)
    assert played.tags("downstream") == ["BoardAvailable"]


def test_a_neighbour_that_dies_while_a_board_comes_leaves_it_uncertain(played: Played) -> None:
    played.connect("upstream")
    played.available("b1")
    played.lane.lost("upstream", "cut", 1.0)
    assert played.orders.calls == ["announce b1", "started", "finished incomplete"]
    assert played.events == ["board-between-machines"]


def test_a_board_that_was_only_offered_is_withdrawn_with_its_neighbour(played: Played) -> None:
    played.orders.held = (BUSY,)
    played.connect("upstream")
    played.available("b1")
    played.lane.lost("upstream", "cut", 1.0)
    assert played.orders.calls == ["announce b1", "withdrawn"]
    assert not played.events


def test_a_board_that_does_not_come_is_given_up_after_its_time(played: Played) -> None:
    played.connect("upstream")
    played.available("b1")
    played.lane.decide(30.5)
    assert played.sent["upstream"][-1] == Message.of("StopTransport", TransferState=INCOMPLETE, BoardId="b1")
    assert played.events == ["board-late"]
    played.take("upstream", "TransportFinished", TransferState=NOT_STARTED, BoardId="b1")
    assert played.orders.calls[-2:] == ["finished not-started", "withdrawn"]


def test_no_board_comes_while_the_places_behind_the_cameras_are_taken() -> None:
    played = Played(places=1)
    played.connect("upstream")
    played.film("run-1")
    assert played.tags("upstream") == ["MachineReady", "RevokeMachineReady"]
    assert [reason.code for reason in played.lane.held] == ["boards-wait"]
    assert played.lane.remove(played.lane.waiting[0].board_id, 1.0)
    assert played.tags("upstream")[-1] == "MachineReady"


def test_a_board_that_was_taken_out_is_revoked(played: Played) -> None:
    played.connect("downstream")
    played.film("run-1")
    assert played.lane.remove(played.lane.waiting[0].board_id, 1.0)
    assert played.tags("downstream")[-1] == "RevokeBoardAvailable"
    assert played.supervised[-1].get("BoardTransfer") == "3"
    assert not played.lane.remove("unknown", 1.0)


def test_the_next_machine_may_ask_for_a_board_by_its_code(played: Played) -> None:
    for side in ROLES:
        played.connect(side)
    played.comes_in("b1", TopBarcode="A7")
    played.film("run-1")
    played.take("downstream", "QueryBoardInfo", TopBarcode="A7")
    assert played.sent["downstream"][-1].get("BoardId") == "b1"
    played.take("downstream", "QueryBoardInfo", TopBarcode="none")
    assert played.sent["downstream"][-1] == Message.of("SendBoardInfo", TopBarcode="none")


def test_an_id_that_two_boards_have_is_passed_on_with_the_first_only() -> None:
    played = Played(places=3)
    for side in ROLES:
        played.connect(side)
    for run in ("run-1", "run-2"):
        played.comes_in("b1")
        played.film(run)
    first, second = played.lane.waiting
    assert (first.board_id, first.announced) == ("b1", True)
    assert second.board_id != "b1"
    assert not second.announced
    assert played.events == ["board-id-twice"]


def two_wait(played: Played) -> tuple[Inside, Inside]:
    """Let two boards wait for a machine that is ready for the first one."""
    played.connect("downstream")
    played.film("run-1")
    played.film("run-2")
    first, second = played.lane.waiting
    played.take("downstream", "MachineReady", FailedBoard=0)
    return first, second


def test_a_start_that_crossed_a_revocation_and_the_next_offer_moves_nothing(played: Played) -> None:
    first, second = two_wait(played)
    assert played.lane.remove(first.board_id, 1.0)
    session = played.lane.sessions["downstream"]
    answer = session.received(Message.of("StartTransport", BoardId=first.board_id), 1.0)
    assert not answer.close
    assert [(m.tag, m.get("TransferState")) for m in answer.send] == [("TransportFinished", NOT_STARTED)]
    played.take("downstream", "StopTransport", BoardId=first.board_id, TransferState=NOT_STARTED)
    assert played.sent["downstream"][-1] == second.message("BoardAvailable")


def test_others_may_ask_for_the_doubt_while_the_first_board_leaves(played: Played) -> None:
    class Leaves(deque[Inside]):
        def __getitem__(self, at: Any) -> Any:
            raise IndexError("it has left meanwhile")

    played.film("run-1")
    played.lane.waiting = Leaves(replace(board, doubtful=True) for board in played.lane.waiting)
    assert [reason.code for reason in played.lane.doubt()] == ["board-between-machines"]


def test_a_stop_that_crossed_a_revocation_takes_no_other_board(played: Played) -> None:
    """A person took the first board out; the next machine started it in the same moment, and says that it has it."""
    first, second = two_wait(played)
    played.lane.sessions["downstream"].sent(Message.of("RevokeBoardAvailable"))
    played.lane.waiting.popleft()
    played.take("downstream", "StartTransport", BoardId=first.board_id)
    played.take("downstream", "StopTransport", BoardId=first.board_id, TransferState=COMPLETE)
    assert list(played.lane.waiting) == [second]


def test_boards_that_leave_without_the_next_machine_are_forgotten_after_a_time(played: Played) -> None:
    for n in range(22):
        played.film(f"run-{n}")
    assert len(played.lane.waiting) == 20
    assert played.events == ["boards-wait"] * 2


def test_a_neighbour_is_not_asked_anew_for_what_only_informs(played: Played) -> None:
    played.connect("downstream")
    played.orders.calls.clear()
    played.orders.held = (BUSY,)
    played.take("downstream", "Notification", NotificationCode=0, Severity=2, Description="door open")
    played.take("downstream", "Command", Command=1)
    assert played.lane.held == ()
    assert played.events == ["neighbour-says"] * 2


def test_a_board_that_may_be_a_bad_one_passes_as_bad_until_the_bad_one_is_seen() -> None:
    played = Played(places=9)
    for side in ROLES:
        played.connect(side)
    played.comes_in("b1", FailedBoard=2)
    bad = played.orders.gap.pop()
    played.film("run-1")  # it is not certain which board this is
    played.orders.gap.append(bad)
    played.film("run-2")
    played.film("run-3")
    assert [board.values["FailedBoard"] for board in played.lane.waiting] == ["2", "2", "0"]
    assert [board.announced for board in played.lane.waiting] == [False, True, False]


def test_a_product_whose_board_type_cannot_be_used_is_announced_as_such(played: Played) -> None:
    boards, announce = list[LineBoard](), played.orders.announce

    def refuse(lane: int, board: LineBoard) -> tuple[Reason, ...]:
        if board.board_type is not None:
            raise NotFoundError("relay is unknown")
        boards.append(board)
        return announce(lane, board)

    played.orders.announce = refuse  # type: ignore[method-assign]
    played.connect("upstream")
    played.available("b1", ProductTypeId="P-1")
    assert played.events == ["product-unusable"]
    assert [(board.board_type, board.unusable) for board in boards] == [(None, True)]


@pytest.mark.parametrize(
    ("after", "leaves"),
    [
        (None, ["run-1", "run-2", None]),
        ("run-1", ["run-1", None, "run-2"]),
        ("run that has ended", [None, "run-1", "run-2"]),
    ],
)
def test_a_board_without_a_run_leaves_behind_the_board_that_it_followed(
    after: str | None, leaves: list[str | None]
) -> None:
    played = Played(places=5)
    for run in ("run-1", "run-2"):
        played.lane.run_began(run, 0.0)
    played.lane.run_ended(None, 1.0, after)
    for run in ("run-1", "run-2"):
        played.lane.run_ended(run, 2.0)
    assert [board.run for board in played.lane.waiting] == leaves


def test_of_two_boards_with_one_id_the_second_stays_bad() -> None:
    played = Played(places=5)
    for side in ROLES:
        played.connect(side)
    for run, failed in (("run-1", 1), ("run-2", 2)):
        played.comes_in("b1", FailedBoard=failed)
        played.lane.run_began(run, 0.0)
    for run in ("run-1", "run-2"):
        played.lane.run_ended(run, 1.0)
    assert [(b.announced, b.values["FailedBoard"]) for b in played.lane.waiting] == [(True, "1"), (False, "2")]


def test_what_is_kept_has_boards_that_are_filmed_and_doubts_the_one_that_leaves() -> None:
    played = Played(places=5)
    played.connect("downstream")
    played.film("run-1")
    played.lane.run_began("run-2", 0.0)
    board = played.lane.waiting[0].board_id
    played.take("downstream", "MachineReady", FailedBoard=0)
    played.take("downstream", "StartTransport", BoardId=board)
    assert [(b.run, b.announced, b.doubtful) for b in played.lane.to_keep()] == [
        ("run-1", False, True),
        ("run-2", False, False),
    ]


def test_a_board_that_is_bad_by_contact_is_passed_on_as_bad_whatever_the_message_says(played: Played) -> None:
    for side in ROLES:
        played.connect(side)
    played.orders.bad_by_contacts = {"run-1", "run-2"}
    played.comes_in("b1", FailedBoard=1)
    played.film("run-1")
    played.film("run-2")
    assert [(b.announced, b.values["FailedBoard"]) for b in played.lane.waiting] == [(True, "2"), (False, "2")]


def test_a_board_that_was_not_filmed_leaves_as_bad_where_contacts_may_have_said_so(played: Played) -> None:
    played.connect("downstream")
    played.orders.bad_by_contacts = {""}
    played.lane.run_ended(None, 0.0)
    assert played.sent["downstream"][-1].values["FailedBoard"] == "2"

"""The station as a machine in the line: it takes boards from its upstream neighbour and offers them to the next one.

| what happens | what the station does |
|---|---|
| the next board may come, and there is room behind the cameras | MachineReady; else RevokeMachineReady |
| BoardAvailable, and the board may come | the order of the board is looked up; StartTransport |
| TransportFinished | StopTransport with the same state |
| the run of the board has ended, so that its matrices are safe | BoardAvailable to the next machine |
| StartTransport of the next machine | TransportFinished after `exit_s`, or when it sends StopTransport |
| the upstream machine is lost while a board moves | the transfer counts as incomplete: a board that comes has no id |
| the next machine is lost while a board moves | all waits until a person has said that the board is out |

No I/O: messages go out by a callback, and times are those of a monotonic clock, s.
"""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

from vaoi_station.errors import VaoiError
from vaoi_station.hermes.messages import Message, Parts
from vaoi_station.hermes.session import COMPLETE, INCOMPLETE, NOT_STARTED, Session, State
from vaoi_station.line_config import Hermes
from vaoi_station.model import Reason
from vaoi_station.runs.run.order_queue import LineBoard

Side = Literal["upstream", "downstream"]
Transfer = Literal["complete", "incomplete", "not-started"]
TRANSFERS: Mapping[str, Transfer] = {NOT_STARTED: "not-started", INCOMPLETE: "incomplete", COMPLETE: "complete"}
FAILED: Mapping[str, Literal["unknown", "good", "bad"]] = {"0": "unknown", "1": "good", "2": "bad"}
SIDES: Mapping[str, Literal["top", "bottom"]] = {"1": "top", "2": "bottom"}
_OWN_IDS = uuid.UUID("6f0c2c1e-0a57-5d0b-9c55-2a3a4b0f9852")
"""Namespace of the ids that stations make for boards without one."""
MOST_WAITING = 20
"""Most boards that can stand behind the cameras, as `hermes.places` has it."""
TRANSFERRED, INSERTED, REMOVED = 1, 3, 3
"""How a board arrived or departed, for the supervisory system."""
_SAY_OUT = "Take the board out if it stands behind the cameras, then say on the page that it is out."


class LineOrders(Protocol):
    """What the lane asks of the queue of orders, and tells it (`OrderRequests`).

    What it tells is answered by what `may_accept` returns then: each answer waits for its turn among other messages.
    """

    def by_messages(self, on: bool, /) -> None:
        """Take whether a neighbour announces every board."""

    def announce(self, lane: int, board: LineBoard, /) -> tuple[Reason, ...]:
        """Take a board that comes next."""

    def withdrawn(self, lane: int, /) -> tuple[Reason, ...]:
        """Take back the announced board."""

    def started(self, lane: int, /) -> tuple[Reason, ...]:
        """Take that the announced board moves now."""

    def finished(self, lane: int, state: Transfer, /) -> tuple[Reason, ...]:
        """Take how the transfer ended."""

    def may_accept(self, lane: int, /) -> tuple[Reason, ...]:
        """Return why the next board must wait; empty if it may come."""

    def board_of_run(self, run: str, /) -> LineBoard | None:
        """Return the announced board of a run; None if there is none, or it is not certain."""

    def came_failed(self, run: str, /) -> bool:
        """Return whether the board of a run came as a failed one, by messages or by contacts.

        With "", for a board without a run: whether it may have.
        """


def announce(orders: LineOrders, config: Hermes, message: Message, publish: Callable[..., Any]) -> tuple[Reason, ...]:
    """Announce the board of a BoardAvailable or BoardForecast to the queue of orders, and return why it must wait.

    If the board type of its product cannot be used, that is published, and the board needs an order that names it.
    """
    codes = (message.get("TopBarcode"), message.get("BottomBarcode"))
    product = message.get("ProductTypeId") or ""
    board = LineBoard(
        board_id=message.values["BoardId"],
        barcodes=tuple(code for code in codes if code),
        product=product,
        board_type=config.products.get(product),
        failed=FAILED[message.get("FailedBoard") or "0"],
        side=SIDES.get(message.get("FlippedBoard") or "0"),
        details=message,
    )
    try:
        return orders.announce(config.lane, board)
    except VaoiError as refusal:
        text = f"hermes.products.{product} cannot be used: {refusal.message}"
        publish("trouble", text, code="product-unusable", action=refusal.action)
        return orders.announce(config.lane, replace(board, board_type=None, unusable=True))


@dataclass(frozen=True)
class Inside:
    """A board in the station, from the barrier until the next machine has it."""

    board_id: str
    values: Mapping[str, str]
    """Its attributes by the messages of the line."""
    parts: Parts
    run: str | None
    announced: bool
    """Whether its id came from the line; else the station made it."""
    doubtful: bool = False
    """Whether it is not known if the next machine has it."""

    def message(self, tag: str, **others: str | int) -> Message:
        """Return a message on this board."""
        return Message.of(tag, self.parts if tag != "BoardForecast" else {}, **{**self.values, **others})


@dataclass
class Lane:
    """One lane. `send` passes a message to a neighbour, `publish` is like `EventLog.add`."""

    config: Hermes
    machine: str
    """Name of the station in messages."""
    speed_mm_s: float | None
    """Speed of the belt for all boards; None: it depends on the board type."""
    orders: LineOrders
    send: Callable[[Side, Message], object]
    publish: Callable[..., Any]
    supervise: Callable[[Message], object] = lambda _: None
    """Passes what arrived and departed to the supervisory system."""
    transfer_s: float = 30.0
    """Longest time of a transport from upstream."""
    sessions: dict[Side, Session] = field(default_factory=dict)
    """The connections whose neighbours have said who they are."""
    waiting: deque[Inside] = field(default_factory=deque)
    """The boards behind the cameras, the next one to leave first."""
    passing: list[str] = field(default_factory=list)
    """The runs whose boards are being filmed or stitched, in the order of their boards; "": a board without a run."""
    held: tuple[Reason, ...] = ()
    """Why the upstream neighbour is not asked for the next board."""
    _started_s: dict[Side, float] = field(default_factory=dict)
    """Times at which a transfer began that has not ended."""
    _offered: Message | None = None
    _came: deque[Message] = field(default_factory=lambda: deque(maxlen=4))
    """The latest boards whose transport began and that no run has shown for certain."""

    @property
    def leaving(self) -> bool:
        """Whether the first board is on its way to the next machine."""
        return "downstream" in self._started_s

    @property
    def passes_on(self) -> bool:
        """Whether there is a next machine to which boards are offered."""
        return self.config.listen is not None

    # --- connections

    def connected(self, side: Side, session: Session, now_s: float) -> None:
        """Take a neighbour that has said who it is."""
        self.sessions[side] = session
        self.decide(now_s)

    def lost(self, side: Side, why: str, now_s: float) -> None:
        """Take the end of a connection. A board that was on its way to or from this neighbour is in doubt."""
        session = self.sessions.pop(side, None)
        if session is None:
            return
        moving, wait = self._started_s.pop(side, None) is not None, None
        board = session.board or "without an id"
        if side == "upstream":
            if moving:
                wait = self.orders.finished(self.config.lane, "incomplete")
            elif self._offered is not None:
                wait = self.orders.withdrawn(self.config.lane)
            self._offered = None
        if moving:
            text = f"The {side} machine was lost ({why}) while board {board} moved: it is not known where the board is."
            self._doubt(side, text)
        self.decide(now_s, wait)

    def _doubt(self, side: Side, text: str) -> None:
        """Publish that a board may stand between two machines; offer no other board to the next one meanwhile."""
        action = "Take the board out if it stands between the machines; let it in again with a new order."
        if side == "downstream" and self.waiting:
            # Offered again, or taken for gone, its id could go to the board behind it.
            self.waiting[0] = replace(self.waiting[0], doubtful=True)
            action = _SAY_OUT
        self.publish("trouble", text, code="board-between-machines", action=action)

    # --- messages

    def received(self, side: Side, message: Message, now_s: float) -> None:
        """Act on a message that the state of its connection allows."""
        wait = None
        match message.tag:
            case "BoardForecast" if self._offered is None and "upstream" not in self._started_s:
                if side == "upstream" and message.get("BoardId"):
                    wait = announce(self.orders, self.config, message, self.publish)
            case "BoardAvailable":
                self._offered = message
                wait = announce(self.orders, self.config, message, self.publish)
            case "RevokeBoardAvailable":
                self._offered = None
                wait = self.orders.withdrawn(self.config.lane)
            case "TransportFinished":
                wait = self._arrived(message)
            case "StartTransport":
                self._started_s["downstream"] = now_s
            case "StopTransport":
                self._taken(message)
            case _:
                self._informed(side, message)
                return
        self.decide(now_s, wait)

    def _informed(self, side: Side, message: Message) -> None:
        """Act on a message on which no transfer depends."""
        match message.tag:
            case "QueryBoardInfo":
                self._tell(side, message)
            case "Notification":
                text = f"The {side} machine says: {message.get('Description') or 'nothing'}"
                kind = "trouble" if message.get("Severity") in ("1", "2") else "line"
                number = message.get("NotificationCode")
                self.publish(kind, f"{text} (notification {number}).", code="neighbour-says")
            case "Command":
                text = f"The {side} machine sends command {message.get('Command')}, which the station does not obey."
                self.publish("line", text, code="neighbour-says")

    def _arrived(self, finished: Message) -> tuple[Reason, ...]:
        """Answer the end of a transfer from upstream, and return why the next board must wait."""
        state, board = finished.values["TransferState"], finished.values["BoardId"]
        self._started_s.pop("upstream", None)
        wait = self.orders.finished(self.config.lane, TRANSFERS[state])
        session = self.sessions["upstream"]
        if session.may_send("StopTransport"):
            self.send("upstream", Message.of("StopTransport", TransferState=state, BoardId=board))
        if state == COMPLETE and self._offered is not None:
            self._track("BoardArrived", self._offered.board(), self._offered.parts, TRANSFERRED)
        elif state == NOT_STARTED:
            self._forget(board)
            wait = self.orders.withdrawn(self.config.lane)  # the machine offers it again, or does not
        elif state == INCOMPLETE:
            self._doubt("upstream", f"Board {board} did not come in completely: it stands between the machines.")
        self._offered = None
        return wait

    def _taken(self, stop: Message) -> None:
        """Take that the next machine has stopped the transfer: it knows whether it has the board."""
        session, state = self.sessions["downstream"], stop.values["TransferState"]
        self._started_s.pop("downstream", None)
        if session.may_send("TransportFinished"):
            self.send("downstream", Message.of("TransportFinished", TransferState=state, BoardId=stop.get("BoardId")))
        # After a revocation that crossed StartTransport, the first board is another one.
        is_first = bool(self.waiting) and self.waiting[0].board_id == stop.get("BoardId")
        if state == COMPLETE and is_first:
            self._depart(self.waiting.popleft(), TRANSFERRED)
        elif state == INCOMPLETE and is_first:
            board = self.waiting[0].board_id
            self._doubt("downstream", f"Board {board} did not leave completely: it stands between the machines.")
        # A board that was not started is still here: it is offered again.

    def _tell(self, side: Side, query: Message) -> None:
        wanted = {name: code for name in ("TopBarcode", "BottomBarcode") if (code := query.get(name))}
        found = (b for b in self.waiting if wanted and all(b.values.get(n) == code for n, code in wanted.items()))
        board = next(found, None)
        self.send(side, Message.of("SendBoardInfo", {}, **wanted) if board is None else board.message("SendBoardInfo"))

    # --- runs

    def run_began(self, run: str, now_s: float) -> None:
        """Take that a board met the barrier."""
        self.passing.append(run)
        session = self.sessions.get("downstream")
        if session is not None and session.state in (State.IDLE, State.READY):
            self.send("downstream", self._board_of(run).message("BoardForecast"))
        self.decide(now_s)

    def run_ended(self, run: str | None, now_s: float, after: str | None = None) -> None:
        """Take that a board is behind the cameras and its run has ended.

        None: it passed without a run, behind all boards so far or behind that of run `after`, which leave before it.
        """
        if run is None:
            # A run that is not here any more has ended, so that its board is in front of all others.
            place = len(self.passing) if after is None else 0
            self.passing.insert(self.passing.index(after) + 1 if after in self.passing else place, "")
        else:
            if run in self.passing:
                self.passing.remove(run)
            self._behind(run)
        while self.passing and not self.passing[0]:
            self.passing.pop(0)
            self._behind(None)
        self.decide(now_s)

    def _behind(self, run: str | None) -> None:
        """Take the next board that stands behind the cameras."""
        board = self._board_of(run)
        if board.announced:
            self._forget(board.board_id)
        else:
            self._track("BoardArrived", board.values, board.parts, INSERTED)
        if self.passes_on:
            self.waiting.append(board)
        if len(self.waiting) > MOST_WAITING:
            board = self.waiting.popleft()
            text = f"Board {board.board_id} is forgotten: {MOST_WAITING} others wait for the next machine."
            action = "If boards leave without it, take hermes.listen out of station.toml; else see why it takes none."
            self.publish("trouble", text, code="boards-wait", action=action)

    def _board_of(self, run: str | None) -> Inside:
        """Return what is known of the board of a run; a board whose id is not certain gets one of this station."""
        known = self.orders.board_of_run(run) if run is not None else None
        if known is not None and any(board.board_id == known.board_id for board in self.waiting):
            text = f"Two boards came as {known.board_id}: the second passes on with an id of the station."
            self.publish(
                "trouble", text, code="board-id-twice", action="Identify both boards; check the machine upstream."
            )
        elif known is not None and isinstance(known.details, Message):
            values = dict(known.details.board())
            if run is not None and self.orders.came_failed(run):
                values["FailedBoard"] = "2"  # by contacts: a bad board stays bad, whatever the message said
            return Inside(known.board_id, values, known.details.parts, run, announced=True)
        return self._own(run, known)

    def to_keep(self) -> tuple[Inside, ...]:
        """Return the boards that stand behind the cameras if the station ends now, as far as their ids are certain."""
        boards = list(self.waiting)
        if boards and self.leaving:
            boards[0] = replace(boards[0], doubtful=True)
        asked = ((run, self.orders.board_of_run(run) if run else None) for run in self.passing)
        return (*boards, *(self._own(run or None, known) for run, known in asked))

    def _own(self, run: str | None, known: LineBoard | None) -> Inside:
        """Return a board with an id of the station."""
        own = str(uuid.uuid5(_OWN_IDS, f"{self.machine}/{run}") if run is not None else uuid.uuid4())
        # It may be any of those that came: if one of them is bad, it must not pass as one that may be good.
        bad = (known is not None and known.failed == "bad") or any(c.get("FailedBoard") == "2" for c in self._came)
        failed = "2" if bad or self.orders.came_failed(run or "") else "0"
        values = {"BoardId": own, "BoardIdCreatedBy": self.machine, "FailedBoard": failed, "FlippedBoard": "0"}
        return Inside(own, values, {}, run, announced=False)

    def _forget(self, board_id: str) -> None:
        """Take that this board is not among those that came and were not seen."""
        for came in [came for came in self._came if came.get("BoardId") == board_id]:
            self._came.remove(came)

    def remove(self, board_id: str, now_s: float) -> bool:
        """Take that somebody took a board out behind the cameras. Return False if it is not there or is leaving."""
        board = next((board for board in self.waiting if board.board_id == board_id), None)
        session = self.sessions.get("downstream")
        is_first = board is not None and board is self.waiting[0]
        if board is None or (is_first and session is not None and session.moving):
            return False
        if is_first and session is not None and session.may_send("RevokeBoardAvailable"):
            self.send("downstream", Message.of("RevokeBoardAvailable"))
        self.waiting.remove(board)
        self._depart(board, REMOVED)
        self.decide(now_s)
        return True

    def _depart(self, board: Inside, how: int) -> None:
        self._track("BoardDeparted", board.values, board.parts, how)

    def _track(self, tag: str, board: Mapping[str, str], parts: Parts, how: int) -> None:
        """Tell the supervisory system of a board."""
        lane = "UpstreamLaneId" if tag == "BoardArrived" else "DownstreamLaneId"
        more: dict[str, str | int] = {"MachineId": self.machine, lane: self.config.lane, "BoardTransfer": how}
        self.supervise(Message.of(tag, parts, **{**board, **more}))

    # --- decisions

    def decide(self, now_s: float, wait: tuple[Reason, ...] | None = None) -> None:
        """Send what is due: whether the next board may come, and which board waits for the next machine.

        `wait` is why the next board must wait, if the queue of orders has just said it.
        """
        if wait is None:
            wait = self.orders.may_accept(self.config.lane)
        self.held = tuple(dict.fromkeys((*wait, *(self.doubt() or self.full()))))  # `wait` may have them too
        self._decide_upstream(now_s)
        self._decide_downstream(now_s)

    def doubt(self) -> tuple[Reason, ...]:
        """Return the reason that it is not known where the first board is; empty if it is known."""
        first = next(iter(tuple(self.waiting)), None)  # other threads ask while boards leave
        if first is None or not first.doubtful:
            return ()
        message = f"It is not known whether the next machine has board {first.board_id}."
        return (Reason(code="board-between-machines", message=message, action=_SAY_OUT),)

    def full(self) -> tuple[Reason, ...]:
        """Return the reason that there is no room behind the cameras; empty if there is."""
        inside = len(self.waiting) + len(self.passing)
        if not self.passes_on or inside < self.config.places:
            return ()
        there = "is ready for no board" if "downstream" in self.sessions else "is not connected"
        message = f"{inside} boards are in the station, and the next machine {there}."
        if not self.waiting:
            message = f"{inside} boards are in the station, and their results are not there yet."
        return (Reason(code="boards-wait", message=message, action="Wait, or look at the next machine."),)

    def _decide_upstream(self, now_s: float) -> None:
        session = self.sessions.get("upstream")
        if session is None:
            return
        begun_s = self._started_s.get("upstream")
        if begun_s is not None and now_s - begun_s > self.transfer_s and session.state is State.TRANSPORTING:
            board = session.board
            self.send("upstream", Message.of("StopTransport", TransferState=INCOMPLETE, BoardId=board))
            message = f"Board {board} did not come within {self.transfer_s:g} s of StartTransport."
            action = "Check the conveyors; a longer way needs a larger line.transport_s and hermes.transfer_s."
            self.publish("trouble", message, code="board-late", action=action)
        if self.held:
            if session.may_send("RevokeMachineReady"):
                self.send("upstream", Message.of("RevokeMachineReady"))
            return
        if session.may_send("MachineReady"):
            self.send("upstream", Message.of("MachineReady", FailedBoard=0))
        if session.state is State.BOTH:
            self.orders.started(self.config.lane)
            self._started_s["upstream"] = now_s
            if self._offered is not None:
                self._came.append(self._offered)
            speed = None if self.speed_mm_s is None else f"{self.speed_mm_s:g}"
            start = Message.of("StartTransport", BoardId=session.board, ConveyorSpeed=speed)
            self.send("upstream", start)

    def _decide_downstream(self, now_s: float) -> None:
        session = self.sessions.get("downstream")
        if session is None or not self.waiting or self.waiting[0].doubtful:
            return
        begun_s = self._started_s.get("downstream")
        if session.state is State.TRANSPORTING and begun_s is not None and now_s - begun_s >= self.config.exit_s:
            board = self.waiting[0].board_id
            self.send("downstream", Message.of("TransportFinished", TransferState=COMPLETE, BoardId=board))
        if session.may_send("BoardAvailable") and not session.moving:
            self.send("downstream", self.waiting[0].message("BoardAvailable"))

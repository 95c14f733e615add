"""One connection to a neighbour as a state machine without I/O: which message may come now, and what is answered.

The machine that has the board is the *sender*: it listens. The machine that gets it is the *receiver*: it connects.

| state | sender's messages | receiver's messages |
|---|---|---|
| idle | BoardAvailable → available | MachineReady → ready |
| available | RevokeBoardAvailable → idle | MachineReady → both |
| ready | BoardAvailable → both | RevokeMachineReady → idle, StartTransport |
| both | RevokeBoardAvailable → ready | RevokeMachineReady → available, StartTransport |
| transporting (after StartTransport) | TransportFinished → finished | StopTransport → stopped |
| stopped | TransportFinished → idle | |
| finished | | StopTransport → idle |

While a board moves, BoardAvailable and RevokeBoardAvailable have no effect: they crossed StartTransport.
StartTransport in "ready", or of a board that was revoked, crossed RevokeBoardAvailable: the sender answers that nothing
began.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import StrEnum
from typing import Literal, NamedTuple

from vaoi_station.hermes.messages import VERSION, Message, listed

HANDSHAKE_S = 20.0
"""Time in which a neighbour says who it is. A connection without it would keep the lane from others."""
ALIVE_S, ANSWER_S = 60.0, 20.0
"""Time of silence after which the other side is asked whether it is there, and time for the answer."""
PROTOCOL_ERROR, REFUSED, RESET, CONFIGURATION_ERROR, SHUTDOWN = 1, 2, 3, 4, 5
"""Codes of notifications."""
FATAL, ERROR, WARNING, INFORMATION = 1, 2, 3, 4
"""Severities of notifications."""
NOT_STARTED, INCOMPLETE, COMPLETE = "1", "2", "3"
"""States of a transfer."""
_MOST_REVOKED = 20
FEATURES = ("FeatureBoardForecast", "FeatureCheckAliveResponse", "FeatureQueryBoardInfo", "FeatureSendBoardInfo")

Role = Literal["sender", "receiver"]


class State(StrEnum):
    """States of the transfer of a board between two machines."""

    CONNECTED = "connected"
    """The neighbour has not said who it is."""
    IDLE = "idle"
    AVAILABLE = "board available"
    READY = "machine ready"
    BOTH = "available and ready"
    TRANSPORTING = "transporting"
    STOPPED = "stopped"
    FINISHED = "finished"
    CLOSED = "closed"


_S = State
_OF_SENDER: Mapping[str, Mapping[State, State]] = {
    "BoardAvailable": {
        _S.IDLE: _S.AVAILABLE,
        _S.READY: _S.BOTH,
        _S.TRANSPORTING: _S.TRANSPORTING,
        _S.STOPPED: _S.STOPPED,
    },
    "RevokeBoardAvailable": {
        _S.AVAILABLE: _S.IDLE,
        _S.BOTH: _S.READY,
        _S.TRANSPORTING: _S.TRANSPORTING,
        _S.STOPPED: _S.STOPPED,
    },
    "TransportFinished": {_S.TRANSPORTING: _S.FINISHED, _S.STOPPED: _S.IDLE},
}
_OF_RECEIVER: Mapping[str, Mapping[State, State]] = {
    "MachineReady": {_S.IDLE: _S.READY, _S.AVAILABLE: _S.BOTH},
    "RevokeMachineReady": {_S.READY: _S.IDLE, _S.BOTH: _S.AVAILABLE},
    "StartTransport": {_S.BOTH: _S.TRANSPORTING, _S.READY: _S.TRANSPORTING},
    "StopTransport": {_S.TRANSPORTING: _S.STOPPED, _S.FINISHED: _S.IDLE},
}
_OF: Mapping[Role, Mapping[str, Mapping[State, State]]] = {"sender": _OF_SENDER, "receiver": _OF_RECEIVER}
_OTHER: Mapping[Role, Role] = {"sender": "receiver", "receiver": "sender"}
_MOVING = frozenset({State.TRANSPORTING, State.STOPPED, State.FINISHED})


class Answer(NamedTuple):
    """What follows from a message, or from the time."""

    send: tuple[Message, ...] = ()
    close: str = ""
    """Why the connection is ended after that; empty: it goes on."""
    news: Message | None = None
    """The message, if the machine has to act on it."""


class Session:
    """The state of one connection. Times are those of a monotonic clock, s."""

    def __init__(self, role: Role, machine: str, lane: int, now_s: float) -> None:
        """Begin when the connection was made; `role` is that of this station."""
        self.role, self.state = role, State.CONNECTED
        self.peer: Message | None = None
        """How the neighbour described itself."""
        self._machine, self._lane = machine, lane
        self._begun_s = self._heard_s = now_s
        self._asked_s: float | None = None
        self.board: str | None = None
        """Id of the board that is available, or moves."""
        self._revoked: deque[str | None] = deque(maxlen=_MOST_REVOKED)
        """Boards that were revoked since the latest StartTransport."""

    @property
    def moving(self) -> bool:
        """Whether a board moves from one machine to the other."""
        return self.state in _MOVING

    @property
    def _answers(self) -> bool:
        """Whether the neighbour answers CheckAlive; a silent one without that feature is found by TCP."""
        features = self.peer.parts.get("SupportedFeatures", ()) if self.peer is not None else ()
        return any(name == "FeatureCheckAliveResponse" for name, _ in features)

    def hello(self) -> Message:
        """Return the description of this station: the receiver sends it first, the sender answers with it."""
        features = listed("SupportedFeatures", FEATURES)
        return Message.of("ServiceDescription", features, MachineId=self._machine, LaneId=self._lane, Version=VERSION)

    def may_send(self, tag: str) -> bool:
        """Return whether this side may send a message now."""
        return self.state in _OF[self.role].get(tag, {})

    def sent(self, message: Message) -> Message:
        """Take over that a message is sent now, and return it. ValueError: it may not be sent in this state."""
        if message.tag in _OF[self.role]:
            if not self.may_send(message.tag):
                raise ValueError(f"{message.tag} as {self.role} in state {self.state}")
            self._advance(self.role, message)
        return message

    def received(self, message: Message, now_s: float) -> Answer:
        """Take a message of the neighbour."""
        if self.state is State.CLOSED:
            return Answer()
        self._heard_s, self._asked_s = now_s, None
        match message.tag:
            case "ServiceDescription":
                return self._described(message)
            case "CheckAlive":
                asked = message.get("Type") == "1"
                return Answer((Message.of("CheckAlive", Type=2, Id=message.get("Id")),) if asked else ())
            case tag if tag in _OF[_OTHER[self.role]]:
                return self._transfer(message)
            case tag if tag in _OF[self.role]:
                return self.refuse(f"{tag} came from the wrong side")
        return Answer(news=message)

    def _described(self, message: Message) -> Answer:
        if self.state is not State.CONNECTED:
            return self.refuse("ServiceDescription came twice")
        self.peer, self.state = message, State.IDLE
        return Answer((self.hello(),) if self.role == "sender" else (), news=message)

    def _transfer(self, message: Message) -> Answer:
        before, other = self.state, _OTHER[self.role]
        if before not in _OF[other][message.tag]:
            return self.refuse(f"{message.tag} came in the state {before!r}")
        board = message.get("BoardId")
        starts = message.tag == "StartTransport"
        revoked = starts and (before is State.READY or (board != self.board and board in self._revoked))
        starts_other = starts and not revoked
        if (starts_other or message.tag in ("StopTransport", "TransportFinished")) and board != self.board:
            return self.refuse(f"{message.tag} names board {board!r}, but it is {self.board!r}")
        if before in (State.TRANSPORTING, State.STOPPED) and message.tag.endswith("BoardAvailable"):
            return Answer()  # it crossed StartTransport on its way
        self._advance(other, message)
        if revoked:
            # RevokeBoardAvailable crossed it on its way: that board is not there any more.
            return Answer((self.sent(Message.of("TransportFinished", TransferState=NOT_STARTED, BoardId=board)),))
        return Answer(news=message)

    def _advance(self, role: Role, message: Message) -> None:
        if message.tag == "RevokeBoardAvailable" and not self.moving:
            self._revoked.append(self.board)
        elif message.tag == "StartTransport":
            self._revoked.clear()
        self.state = _OF[role][message.tag][self.state]
        if message.tag in ("BoardAvailable", "StartTransport"):
            self.board = message.get("BoardId")
        elif self.state in (State.IDLE, State.READY):
            self.board = None

    def tick(self, now_s: float) -> Answer:
        """Return what is due: the question whether the neighbour is there, or the end of a silent connection."""
        if self.state is State.CLOSED:
            return Answer()
        if self.state is State.CONNECTED:
            late = now_s - self._begun_s > HANDSHAKE_S
            return self.refuse(f"no ServiceDescription within {HANDSHAKE_S:g} s") if late else Answer()
        asked_s = self._asked_s
        if asked_s is not None and self._answers and now_s - asked_s > ANSWER_S:
            self.state = State.CLOSED
            return Answer(close=f"no answer to CheckAlive within {ANSWER_S:g} s")
        if now_s - max(self._heard_s, asked_s or 0.0) <= ALIVE_S:
            return Answer()
        self._asked_s = now_s
        return Answer((Message.of("CheckAlive", Type=1, Id=f"{now_s:.0f}"),))

    def refuse(self, why: str) -> Answer:
        """End the connection because of what the neighbour did, and say so."""
        self.state = State.CLOSED
        return Answer((notification(PROTOCOL_ERROR, FATAL, why),), close=why)


def notification(code: int, severity: int, text: str) -> Message:
    """Return a notification to the neighbour."""
    return Message.of("Notification", NotificationCode=code, Severity=severity, Description=text)

"""Two machines that send what their states allow, in any order, never refuse each other; all else is refused."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from vaoi_station.hermes.messages import Message, listed
from vaoi_station.hermes.session import ALIVE_S, ANSWER_S, HANDSHAKE_S, Answer, Role, Session, State

BOARD = "5f1c0e3a-0000-0000-0000-000000000001"
VALUES = {
    "BoardAvailable": {"BoardId": BOARD, "BoardIdCreatedBy": "a", "FailedBoard": "1", "FlippedBoard": "0"},
    "RevokeBoardAvailable": {},
    "TransportFinished": {"BoardId": BOARD, "TransferState": "3"},
    "MachineReady": {"FailedBoard": "0"},
    "RevokeMachineReady": {},
    "StartTransport": {"BoardId": BOARD},
    "StopTransport": {"BoardId": BOARD, "TransferState": "3"},
}
OF: dict[Role, tuple[str, ...]] = {"sender": tuple(VALUES)[:3], "receiver": tuple(VALUES)[3:]}
WAYS: dict[State, tuple[tuple[Role, str], ...]] = {
    State.IDLE: (),
    State.AVAILABLE: (("sender", "BoardAvailable"),),
    State.READY: (("receiver", "MachineReady"),),
    State.BOTH: (("sender", "BoardAvailable"), ("receiver", "MachineReady")),
}
WAYS[State.TRANSPORTING] = (*WAYS[State.BOTH], ("receiver", "StartTransport"))
WAYS[State.FINISHED] = (*WAYS[State.TRANSPORTING], ("sender", "TransportFinished"))
WAYS[State.STOPPED] = (*WAYS[State.TRANSPORTING], ("receiver", "StopTransport"))
ALLOWED = {
    ("idle", "BoardAvailable"): "board available",
    ("idle", "MachineReady"): "machine ready",
    ("board available", "RevokeBoardAvailable"): "idle",
    ("board available", "MachineReady"): "available and ready",
    ("machine ready", "BoardAvailable"): "available and ready",
    ("machine ready", "RevokeMachineReady"): "idle",
    ("machine ready", "StartTransport"): "finished",
    ("available and ready", "RevokeBoardAvailable"): "machine ready",
    ("available and ready", "RevokeMachineReady"): "board available",
    ("available and ready", "StartTransport"): "transporting",
    ("transporting", "BoardAvailable"): "transporting",
    ("transporting", "RevokeBoardAvailable"): "transporting",
    ("transporting", "TransportFinished"): "finished",
    ("transporting", "StopTransport"): "stopped",
    ("stopped", "BoardAvailable"): "stopped",
    ("stopped", "RevokeBoardAvailable"): "stopped",
    ("stopped", "TransportFinished"): "idle",
    ("finished", "StopTransport"): "idle",
}
"""State after a message that may be received, by chapter 2.6 of the standard; all others end the connection."""


def message(tag: str) -> Message:
    return Message.of(tag, {}, **VALUES[tag])


def hello(*features: str) -> Message:
    return Message.of(
        "ServiceDescription", listed("SupportedFeatures", features), MachineId="other", LaneId=1, Version="1.2"
    )


def session_in(state: State, role: Role) -> Session:
    session = Session(role, "station", 1, 0.0)
    session.received(hello(), 0.0)
    for who, tag in WAYS[state]:
        if who == role:
            session.sent(message(tag))
        else:
            session.received(message(tag), 0.0)
    assert session.state is state
    return session


@pytest.mark.parametrize("role", ["sender", "receiver"])
@pytest.mark.parametrize("state", list(WAYS))
def test_every_message_in_every_state(state: State, role: Role) -> None:
    other: Role = "receiver" if role == "sender" else "sender"
    for tag in VALUES:
        session = session_in(state, role)
        answer = session.received(message(tag), 1.0)
        expected = ALLOWED.get((str(state), tag)) if tag in OF[other] else None
        if expected is None:
            assert answer.close
            assert session.state is State.CLOSED
            (said,) = answer.send
            assert (said.get("NotificationCode"), said.get("Severity")) == ("1", "1")
        else:
            assert not answer.close
            assert session.state == expected, tag


class TwoMachines(RuleBasedStateMachine):
    """Both send whatever they may, at any time, over connections on which messages cross."""

    def __init__(self) -> None:
        super().__init__()
        self.ends: dict[Role, Session] = {role: Session(role, role, 1, 0.0) for role in OF}
        self.wires: dict[Role, deque[Message]] = {"sender": deque(), "receiver": deque([self.ends["receiver"].hello()])}
        """Messages on their way from each machine."""

    @rule(role=st.sampled_from(tuple(OF)), data=st.data())
    def send(self, role: Role, data: st.DataObject) -> None:
        # A receiver that does not know of a board does not start its transport.
        end = self.ends[role]
        may = [tag for tag in OF[role] if end.may_send(tag) and not (end.moving and "Board" in tag)]
        may = [tag for tag in may if tag != "StartTransport" or end.state is State.BOTH]
        if may:
            tag = data.draw(st.sampled_from(may))
            self.wires[role].append(end.sent(message(tag)))

    @rule(role=st.sampled_from(tuple(OF)))
    def ask(self, role: Role) -> None:
        self.wires[role].append(Message.of("CheckAlive", Type=1, Id="1"))

    @precondition(lambda self: any(self.wires.values()))
    @rule(first=st.sampled_from(tuple(OF)))
    def deliver(self, first: Role) -> None:
        role = first if self.wires[first] else next(r for r in OF if self.wires[r])
        other: Role = "receiver" if role == "sender" else "sender"
        answer = self.ends[other].received(self.wires[role].popleft(), 0.0)
        assert not answer.close, answer.close
        self.wires[other] += answer.send

    @invariant()
    def agree_when_nothing_is_on_its_way(self) -> None:
        if not any(self.wires.values()):
            sender, receiver = self.ends["sender"], self.ends["receiver"]
            assert sender.state == receiver.state
            assert sender.board == receiver.board

    def teardown(self) -> None:
        """From every state a board can still be moved: no state is a trap."""
        while any(self.wires.values()):
            self.deliver("sender")
        order = ("StopTransport", "TransportFinished", "MachineReady", "BoardAvailable", "StartTransport")
        for tag in (*order[:2], *order[:2], *order[2:], *order[:2]):
            role: Role = "sender" if tag in OF["sender"] else "receiver"
            end = self.ends[role]
            if end.may_send(tag) and not (end.moving and tag == "BoardAvailable"):
                self.wires[role].append(end.sent(message(tag)))
            while any(self.wires.values()):
                self.deliver(role)
        assert self.ends["sender"].state is State.IDLE


TestTwoMachines = TwoMachines.TestCase


def test_a_board_that_was_revoked_while_it_was_started_is_not_started() -> None:
    sender = session_in(State.READY, "sender")
    (said,) = sender.received(message("StartTransport"), 0.0).send
    assert (said.tag, said.get("TransferState")) == ("TransportFinished", "1")


@pytest.mark.parametrize("tag", ["StartTransport", "TransportFinished", "StopTransport"])
def test_a_message_on_another_board_ends_the_connection(tag: str) -> None:
    states = {"StartTransport": State.BOTH, "TransportFinished": State.TRANSPORTING, "StopTransport": State.FINISHED}
    session = session_in(states[tag], "receiver" if tag in OF["sender"] else "sender")
    other = Message.of(tag, {}, **{**VALUES[tag], "BoardId": "another"})
    assert "another" in session.received(other, 0.0).close


def test_a_question_is_answered_and_a_mere_sign_of_life_is_not() -> None:
    session = session_in(State.IDLE, "sender")
    (pong,) = session.received(Message.of("CheckAlive", Type=1, Id="17"), 0.0).send
    assert (pong.get("Type"), pong.get("Id")) == ("2", "17")
    assert session.received(Message.of("CheckAlive"), 0.0) == Answer()


def test_a_neighbour_that_does_not_say_who_it_is_is_sent_away() -> None:
    session = Session("sender", "station", 1, 100.0)
    assert not session.tick(100.0 + HANDSHAKE_S).close
    assert "ServiceDescription" in session.tick(100.1 + HANDSHAKE_S).close


def test_a_silent_neighbour_that_answers_questions_is_given_up() -> None:
    session = Session("sender", "station", 1, 0.0)
    session.received(hello("FeatureCheckAliveResponse"), 0.0)
    assert session.tick(ALIVE_S) == Answer()
    (question,) = session.tick(ALIVE_S + 1).send
    assert question.tag == "CheckAlive"
    assert "CheckAlive" in session.tick(ALIVE_S + ANSWER_S + 2).close


def test_a_silent_neighbour_of_an_older_standard_is_kept() -> None:
    session = Session("sender", "station", 1, 0.0)
    session.received(hello(), 0.0)
    session.tick(ALIVE_S + 1)
    assert not session.tick(ALIVE_S + ANSWER_S + 2).close
    assert len(session.tick(2 * ALIVE_S + 2).send) == 1

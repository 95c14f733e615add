"""Messages are read as the standard says, and what is no message is refused with a sentence."""

from __future__ import annotations

import pytest

from vaoi_station.errors import InputError
from vaoi_station.hermes.messages import MESSAGES, MOST_BYTES, Message, ProtocolError, message_of_text, read_message

BOARD = {"BoardId": "a", "BoardIdCreatedBy": "printer", "FailedBoard": "2", "FlippedBoard": "1"}


def xml(body: str) -> bytes:
    return f'<Hermes Timestamp="2026-01-01T12:00:00.000"><{body}</Hermes>'.encode()


def test_a_message_is_read_as_it_was_written() -> None:
    subs = (("SB", {"Pos": "1", "Bc": 'a<b>"&', "St": "2"}), ("SB", {"Pos": "2", "St": "4"}))
    message = Message.of("BoardAvailable", {"SubBoards": subs}, **BOARD, TopBarcode="ä ß", Length="120.5")
    read = read_message(message.to_bytes())
    assert read is not None
    assert (read.tag, read.values, read.parts) == (message.tag, message.values, message.parts)


def test_unknown_attributes_are_ignored() -> None:
    assert read_message(xml('MachineReady FailedBoard="0" Colour="red"/>')) == Message.of("MachineReady", FailedBoard=0)


def test_an_unknown_message_is_none() -> None:
    assert read_message(xml("FirstUnknown/>")) is None


def test_an_optional_attribute_that_is_wrong_is_left_out_and_named() -> None:
    message = read_message(xml('MachineReady FailedBoard="0" Length="-3"/>'))
    assert message is not None
    assert "Length" not in message.values
    assert message.left_out == ("Length is '-3', but must be a number above 0",)


@pytest.mark.parametrize("length", ["nan", "inf", "1e999", "1_0", "0x10", " 5", "٣"])
def test_a_length_is_a_plain_number(length: str) -> None:
    message = read_message(xml(f'MachineReady FailedBoard="0" Length="{length}"/>'))
    assert message is not None
    assert "Length" not in message.values


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"<Hermes><MachineReady</Hermes>", "no XML"),
        (b"<Hermes></Hermes>", "0 elements"),
        (xml('MachineReady FailedBoard="0"/><CheckAlive/>'), "2 elements"),
        (b"<Other><CheckAlive/></Other>", "'Other'"),
        (xml("MachineReady/>"), "FailedBoard is absent"),
        (xml('MachineReady FailedBoard="3"/>'), "FailedBoard is '3', but must be a whole number from 0 to 2"),
        (xml('StartTransport BoardId=" "/>'), "BoardId is ' '"),
        (xml('ServiceDescription MachineId="m" LaneId="0" Version="1.6"/>'), "LaneId is '0'"),
        (xml('ServiceDescription MachineId="m" LaneId="1" Version="one"/>'), "Version is 'one'"),
        (b'<Hermes><CheckAlive Id="&lol;"/></Hermes>', "no XML"),
        (b"<Hermes><!-- x --><CheckAlive/></Hermes>", "comment"),
        (b"<Hermes><?x y?><CheckAlive/></Hermes>", "instruction"),
        (b'<Hermes><CheckAlive Id="\xff"/></Hermes>', "no XML"),
        (b"<Hermes>" + b"<a>" * 20_000 + b"</a>" * 10 + b"</Hermes>", "no XML"),
    ],
)
def test_what_is_no_message_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(ProtocolError, match=words):
        read_message(data)


def test_sub_boards_are_left_out_of_a_message_that_would_be_too_long() -> None:
    subs = tuple(("SB", {"Pos": str(n), "Bc": "x" * 50, "St": "1"}) for n in range(2000))
    data = Message.of("BoardAvailable", {"SubBoards": subs}, **BOARD).to_bytes()
    assert len(data) < MOST_BYTES
    read = read_message(data)
    assert read is not None
    assert read.values == BOARD


def test_a_message_can_be_given_as_a_text() -> None:
    assert message_of_text("BoardAvailable:ProductTypeId=P1,FailedBoard=2") == Message.of(
        "BoardAvailable", ProductTypeId="P1", FailedBoard=2
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Board", "must be one of .*BoardAvailable"),
        ("StartTransport:Speed=3", "must be NAME=VALUE with BoardId, ConveyorSpeed"),
        ("BoardAvailable:FailedBoard=3", "FailedBoard is '3', but must be a whole number from 0 to 2"),
    ],
)
def test_a_text_that_is_no_message_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        message_of_text(text)


def test_no_attribute_is_both_necessary_and_optional() -> None:
    assert all(not must & may for must, may in MESSAGES.values())

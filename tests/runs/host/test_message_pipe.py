"""The station's end of a pipe: no call waits for the child."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import pytest

from vaoi_station.runs.host.message_pipe import MessagePipe, PipeEndedError, wait_for

Ends = tuple[MessagePipe, "Connection[Any, Any]"]
LARGE = b"x" * 3_000_000


@pytest.fixture
def ends() -> Iterator[Ends]:
    here, there = multiprocessing.Pipe()
    pipe = MessagePipe(here)
    yield pipe, there
    pipe.close()
    there.close()


def receive(pipe: MessagePipe, count: int) -> list[Any]:
    messages: list[Any] = []
    while len(messages) < count:
        assert wait_for([pipe], (), 10.0)
        messages += pipe.receive()
    return messages


def test_messages_of_any_size_arrive_in_order_both_ways(ends: Ends) -> None:
    pipe, there = ends
    wanted = ["first", LARGE, {"third": 3}]

    def answer() -> None:
        for _ in wanted:
            there.send(there.recv())

    answers = threading.Thread(target=answer)
    answers.start()
    for message in wanted:
        pipe.send(message)
    got: list[Any] = []
    while len(got) < len(wanted):
        assert pipe.fileno() in wait_for([pipe], (), 10.0)
        pipe.flush()
        got += pipe.receive()
    answers.join()
    assert got == wanted
    assert not pipe.unsent


def test_a_child_that_does_not_read_blocks_no_caller(ends: Ends) -> None:
    pipe, there = ends
    for _ in range(4):
        pipe.send(LARGE)
    assert pipe.unsent
    assert not wait_for([pipe], (), 0.0)
    there.close()
    pipe.flush()
    assert not pipe.unsent, "what a child that has ended did not read is dropped"


def test_bytes_that_are_no_message_end_the_pipe(ends: Ends) -> None:
    pipe, there = ends
    there.send_bytes(b"no pickle")
    with pytest.raises(PipeEndedError, match="cannot be read"):
        pipe.receive()

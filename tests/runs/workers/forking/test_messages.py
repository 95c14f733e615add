"""Messages with file descriptors between the station and the fork server."""

from __future__ import annotations

import os
import resource
import socket

import pytest

from vaoi_station.runs.workers.forking.messages import Fork, Ping, pair, receive, send


def test_a_message_arrives_with_a_copy_of_its_descriptor() -> None:
    here, there = pair()
    with here, there:
        reads, writes = os.pipe()
        send(here, Fork(1, "ring"), [writes])
        send(here, Ping())
        os.close(writes)
        received = receive(there)
        assert received is not None
        message, [copy] = received
        assert message == Fork(1, "ring")
        assert not os.get_inheritable(copy)
        os.write(copy, b"x")
        assert os.read(reads, 1) == b"x"
        assert receive(there) == (Ping(), [])
        for descriptor in (reads, copy):
            os.close(descriptor)


def test_the_end_of_the_other_side_is_no_message() -> None:
    here, there = pair()
    with there:
        send(there, Ping())
        here.close()
        assert receive(there) is None
        with pytest.raises(BrokenPipeError):
            send(there, Ping())


def test_a_socket_that_does_not_block_raises_without_message_and_without_room() -> None:
    here, there = pair()
    with here, there:
        for end in (here, there):
            end.setblocking(False)
        with pytest.raises(BlockingIOError):
            receive(there)
        with pytest.raises(BlockingIOError):
            send_without_end(here)


def send_without_end(to: socket.socket) -> None:
    while True:
        send(to, Ping())


def test_a_descriptor_without_room_is_missing() -> None:
    here, there = pair()
    with here, there:
        send(here, Fork(0, "ring"), [here.fileno()])
        before = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, before[1]))
        try:
            assert receive(there) == (Fork(0, "ring"), [])
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)

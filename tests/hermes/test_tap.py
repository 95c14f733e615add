"""The tap passes every byte on, with a station and without, and the station reads the same announcements along."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from string import Template

import pytest

from tests.hermes.station import PlayedStation, free_port, wait_for
from tests.hermes.test_service import HELLO, Peer
from vaoi_station.child_environment import child_environment
from vaoi_station.hermes.messages import Message
from vaoi_station.hermes.service import TAP_SOCKET

UNIT = (Path(__file__).parents[2] / "deploy" / "vaoi-hermes-tap.service").read_text(encoding="utf-8")
BOARD = {"BoardId": "b1", "BoardIdCreatedBy": "printer", "FailedBoard": "1", "FlippedBoard": "1"}


@contextmanager
def tap(listen: int, target: int, station: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run the command of the unit that the package installs."""
    started = re.search(r"^ExecStart=\S+ (.*)$", UNIT, re.MULTILINE)
    assert started is not None
    given = {"LISTEN": f"127.0.0.1:{listen}", "TARGET": f"127.0.0.1:{target}", "SOCKET": str(station)}
    arguments = Template(started[1]).substitute(given).split()
    process = subprocess.Popen([sys.executable, *arguments], env=child_environment())
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def played(tmp_path: Path) -> PlayedStation:
    return PlayedStation(tmp_path, tap=True)


def transfer(played: PlayedStation, listen: int, server: socket.socket, *, last: str = "StopTransport") -> None:
    """Let two machines transfer a board through the tap, and check that they hear each other."""
    with closing(played.connect(listen)) as receiving, closing(server.accept()[0]) as sending:
        receiver, sender = Peer(receiving), Peer(sending)
        for one, other, message in (
            (receiver, sender, HELLO),
            (sender, receiver, HELLO),
            (receiver, sender, Message.of("MachineReady", FailedBoard=0)),
            (sender, receiver, Message.of("BoardAvailable", {}, **BOARD)),
            (receiver, sender, Message.of("StartTransport", BoardId="b1")),
            (sender, receiver, Message.of("TransportFinished", TransferState=3, BoardId="b1")),
            (receiver, sender, Message.of("StopTransport", TransferState=3, BoardId="b1")),
        ):
            one.send(message)
            assert other.next(message.tag) == message
            if message.tag == last:
                break


def test_a_transfer_passes_without_a_station_and_with_one(played: PlayedStation, tmp_path: Path) -> None:
    listen = free_port()
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.settimeout(30)
        with tap(listen, server.getsockname()[1], tmp_path / TAP_SOCKET):
            transfer(played, listen, server)
            with played.running():
                wait_for((tmp_path / TAP_SOCKET).exists)
                transfer(played, listen, server)
                wait_for(lambda: "finished complete" in played.orders.calls)
                assert played.orders.calls == ["announce b1", "started", "finished complete"]
            transfer(played, listen, server)


def test_a_connection_that_breaks_while_a_board_moves_is_uncertain(played: PlayedStation, tmp_path: Path) -> None:
    listen = free_port()
    with closing(socket.create_server(("127.0.0.1", 0))) as server, played.running():
        server.settimeout(30)
        wait_for((tmp_path / TAP_SOCKET).exists)
        with tap(listen, server.getsockname()[1], tmp_path / TAP_SOCKET):
            transfer(played, listen, server, last="StartTransport")
            wait_for(lambda: played.orders.calls[-1:] == ["finished incomplete"])


def test_a_tap_that_was_killed_is_there_again_when_it_is_started(played: PlayedStation, tmp_path: Path) -> None:
    listen = free_port()
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.settimeout(30)
        for _ in range(2):
            with tap(listen, server.getsockname()[1], tmp_path / TAP_SOCKET):
                transfer(played, listen, server)


def test_the_unit_finds_the_socket_of_a_packaged_station() -> None:
    assert f"Environment=SOCKET=/var/lib/vaoi-station/data/{TAP_SOCKET}\n" in UNIT

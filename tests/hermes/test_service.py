"""The connections withstand what neighbours do wrong, and the boards behind the cameras survive a restart."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest

from tests.hermes.station import PlayedStation, free_port, wait_for
from vaoi_station.errors import StateError
from vaoi_station.hermes import service
from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.messages import Message, read_message
from vaoi_station.model import Reason

WAIT_S = 30.0
HELLO = Message.of("ServiceDescription", MachineId="other", LaneId=1, Version="1.6")
BOMB = b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]><Hermes><CheckAlive Id="&b;"/></Hermes>'


class Peer:
    """A connection of a test to the station."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        connection.settimeout(WAIT_S)
        self._framing, self._came = Framing(), list[Message]()

    def send(self, *messages: Message) -> None:
        self.connection.sendall(b"".join(message.to_bytes() for message in messages))

    def next(self, tag: str) -> Message:
        while True:
            while self._came:
                if (message := self._came.pop(0)).tag == tag:
                    return message
            data = self.connection.recv(65_536)
            assert data, f"ended before {tag}"
            self._came += [m for raw in self._framing.feed(data) if (m := read_message(raw)) is not None]

    def ends(self) -> bool:
        """Return whether the station ends the connection."""
        with suppress(ConnectionResetError):
            while self.connection.recv(65_536):
                pass
        return True


@contextmanager
def downstream(station: PlayedStation, port: int, *, known: bool = True) -> Iterator[Peer]:
    with closing(station.connect(port)) as connection:
        peer = Peer(connection)
        if known:
            peer.send(HELLO)
            peer.next("ServiceDescription")
        yield peer


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def station(tmp_path: Path, port: int) -> Iterator[PlayedStation]:
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}", exit_s=0.1).running() as running:
        yield running


def test_a_second_machine_hears_that_the_lane_is_taken(station: PlayedStation, port: int) -> None:
    with downstream(station, port) as first, downstream(station, port, known=False) as second:
        said = second.next("Notification")
        assert (said.get("NotificationCode"), said.get("Severity")) == ("2", "2")
        assert second.ends()
        first.send(Message.of("CheckAlive", Type=1, Id="5"))
        assert first.next("CheckAlive").get("Id") == "5"


@pytest.mark.parametrize(
    "data", [BOMB, b"<Hermes>" + b"x" * 200_000, b"<Hermes><MachineReady></Hermes>", b"\0" * 200_000, b"GET /" * 50_000]
)
def test_what_is_no_message_ends_the_connection_and_the_next_one_works(
    station: PlayedStation, port: int, data: bytes
) -> None:
    with downstream(station, port) as peer:
        with suppress(OSError):  # it may end before all was sent
            peer.connection.sendall(data)
        assert peer.ends()
    with downstream(station, port) as again:
        again.send(Message.of("CheckAlive", Type=1, Id="5"))
        again.next("CheckAlive")


def test_a_flood_of_messages_ends_the_connection(station: PlayedStation, port: int) -> None:
    with downstream(station, port) as peer:
        with suppress(OSError):
            peer.send(*[Message.of("CheckAlive")] * 20_000)
        assert peer.ends()
    shown = station.service.status().messages
    assert any("more than 500 messages" in message.fault for message in shown)


def test_clocks_years_apart_are_shown_and_change_nothing(station: PlayedStation, port: int) -> None:
    with downstream(station, port) as peer:
        for stamp in ("1970-01-01T00:00:00.000", "9999-12-31T23:59:59.999", "yesterday", ""):
            data = Message("CheckAlive", {"Type": "1", "Id": "1"}, {}, stamp).to_bytes()
            peer.connection.sendall(data)
            peer.next("CheckAlive")
        old = Message("CheckAlive", {"Type": "1", "Id": "1"}, {}, "2016-01-01T00:00:00.000Z")
        peer.connection.sendall(old.to_bytes())
        peer.next("CheckAlive")
        off_s = station.service.status().neighbours[0].clock_off_s
        assert off_s is not None
        assert off_s < -1e8


def test_a_fault_of_the_queue_of_orders_ends_neither_thread_nor_line(station: PlayedStation, port: int) -> None:
    def fail(lane: int) -> tuple[Reason, ...]:
        raise RuntimeError("fault")

    station.orders.may_accept = fail  # type: ignore[method-assign]
    with downstream(station, port) as peer:
        peer.send(Message.of("MachineReady", FailedBoard=0), Message.of("CheckAlive", Type=1, Id="5"))
        peer.next("CheckAlive")
    assert station.service.thread.fault() is None


def test_boards_behind_the_cameras_survive_a_restart(tmp_path: Path, port: int) -> None:
    table = {"listen": f"127.0.0.1:{port}", "exit_s": 0.1, "places": 5}
    with PlayedStation(tmp_path, **table).running() as before:
        before.film()
        before.film()
        wait_for(lambda: len(before.service.status().boards) == 2)
    kept = [board.board_id for board in before.service.status().boards]
    with PlayedStation(tmp_path, **table).running() as after, downstream(after, port) as peer:
        assert [board.board_id for board in after.service.status().boards] == kept
        assert peer.next("BoardAvailable").get("BoardId") == kept[0]


@pytest.mark.parametrize("ended", [False, True])
def test_a_board_that_is_filmed_as_the_station_ends_stands_behind_the_cameras_then(
    tmp_path: Path, port: int, ended: bool
) -> None:
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").running() as before:
        before.events.add("run", "A board is being filmed.", state="filming", run="r1")
        wait_for(lambda: before.service._lane.passing == ["r1"])
        if ended:
            before.events.add("run", "Done.", state="ready", run="r1")
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").running() as after:
        wait_for(lambda: [board.run for board in after.service.status().boards] == ["r1"])


def test_a_board_can_be_taken_out_by_hand(station: PlayedStation) -> None:
    station.film()
    wait_for(lambda: len(station.service.status().boards) == 1)
    (board,) = station.service.status().boards
    assert not station.service.remove(board.board_id).boards
    with pytest.raises(StateError, match="does not wait"):
        station.service.remove(board.board_id)


def test_a_neighbour_hears_that_the_station_stops(tmp_path: Path, port: int) -> None:
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").running() as station:
        connection = station.connect(port)
        peer = Peer(connection)
        peer.send(HELLO)
        peer.next("ServiceDescription")
    assert peer.next("Notification").get("NotificationCode") == "5"
    connection.close()


def test_an_address_that_is_in_use_is_a_warning_and_is_tried_again(
    tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "RETRY_S", 0.05)
    taken = socket.create_server(("127.0.0.1", port))
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").running() as station:
        wait_for(lambda: [reason.code for reason in station.service.reasons()] == ["line-address"])
        taken.close()
        wait_for(lambda: not station.service.reasons())


def test_before_it_runs_there_is_nothing_to_warn_of(tmp_path: Path, port: int) -> None:
    assert PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").service.reasons() == ()


def test_a_neighbour_that_is_away_is_a_warning(tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "LOST_S", 0.0)
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").running() as station:
        wait_for(lambda: [reason.code for reason in station.service.reasons()] == ["neighbour-lost"])
        with downstream(station, port):
            wait_for(lambda: not station.service.reasons())


def test_a_supervisory_system_hears_of_boards_and_reads_the_configuration(tmp_path: Path, port: int) -> None:
    above = free_port()
    table = {"listen": f"127.0.0.1:{port}", "supervisor": f"127.0.0.1:{above}"}
    with PlayedStation(tmp_path, **table).running() as station, closing(station.connect(above)) as connection:
        peer = Peer(connection)
        peer.send(Message.of("SupervisoryServiceDescription", SystemId="mes", Version="1.6"))
        assert peer.next("SupervisoryServiceDescription").get("SystemId") == "line-1"
        peer.send(Message.of("GetConfiguration"), Message.of("SetConfiguration"), Message.of("QueryHermesCapabilities"))
        configured = peer.next("CurrentConfiguration")
        assert configured.parts["DownstreamConfigurations"][0][1]["Port"] == str(port)
        assert peer.next("Notification").get("NotificationCode") == "4"
        peer.next("SendHermesCapabilities")
        station.film()
        assert peer.next("BoardArrived").get("BoardTransfer") == "3"


def test_what_a_supervisory_system_must_not_send_is_shown(tmp_path: Path, port: int) -> None:
    table = {"listen": f"127.0.0.1:{port}", "supervisor": f"127.0.0.1:{(above := free_port())}"}
    with PlayedStation(tmp_path, **table).running() as station, closing(station.connect(above)) as connection:
        peer = Peer(connection)
        connection.sendall(BOMB)
        assert peer.next("Notification").get("NotificationCode") == "1"
        assert [record.code for record in station.events.records] == ["neighbour-refused"]
        assert "document type" in station.service.status().messages[-1].fault


def test_connections_of_supervisory_systems_are_few_and_must_say_something(
    tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "HANDSHAKE_S", 0.5)
    table = {"listen": f"127.0.0.1:{port}", "supervisor": f"127.0.0.1:{(above := free_port())}"}
    with PlayedStation(tmp_path, **table).running() as station, ExitStack() as stack:
        silent = [Peer(stack.enter_context(closing(station.connect(above)))) for _ in range(6)]
        wait_for(lambda: len(station.service._open) == 6)
        refused = Peer(stack.enter_context(closing(station.connect(above))))
        assert refused.next("Notification").get("NotificationCode") == "2"
        assert all(peer.ends() for peer in silent)
        again = Peer(stack.enter_context(closing(station.connect(above))))
        again.send(Message.of("GetConfiguration"))
        again.next("CurrentConfiguration")


def test_a_full_place_holds_the_line_also_if_no_message_comes_from_upstream(station: PlayedStation) -> None:
    station.film()
    wait_for(lambda: [reason.code for reason in station.service.reasons()] == ["boards-wait"])

"""The acceptance tests of the standard's authors, as they were recorded against this station, pass again.

`acceptance.json` has what hermes-org/acceptance_tests sent and waited for in its 12 automatic and 6 interactive cases.
"""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from tests.hermes.station import PlayedStation, free_port
from vaoi_station.hermes import service
from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.messages import read_message

CASES: dict[str, list[list[Any]]] = json.loads((Path(__file__).parent / "acceptance.json").read_text())
WAIT_S = 30.0


class Machine:
    """One end of the recorded suite."""

    def __init__(self) -> None:
        self.server: socket.socket | None = None
        self.connection: socket.socket | None = None
        self._framing, self._came = Framing(), list[bytes]()

    def expect(self, tag: str) -> str:
        """Wait for a message; return the id of its board."""
        assert self.connection is not None
        while True:
            while self._came:
                message = read_message(self._came.pop(0))
                assert message is not None
                if message.tag == tag:
                    return message.get("BoardId") or ""
            data = self.connection.recv(65_536)
            assert data, f"the station ended the connection before {tag}"
            self._came += self._framing.feed(data)

    def expect_reset(self, text: str) -> None:
        """Send one more message to a station that has refused: it resets the connection."""
        assert self.connection is not None
        self.connection.sendall(text.encode())
        with pytest.raises(ConnectionResetError):
            self.connection.recv(1)

    def close(self) -> None:
        for end in (self.connection, self.server):
            if end is not None:
                end.close()


@pytest.mark.parametrize("name", list(CASES))
def test_recorded_case(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "RETRY_S", 0.05)
    ports, machines, board = {"connect": free_port(), "listen": free_port()}, dict[int, Machine](), ""
    table = {"upstream": f"127.0.0.1:{ports['listen']}", "listen": f"127.0.0.1:{ports['connect']}"}
    with PlayedStation(tmp_path, **table, exit_s=0.1).running() as station:
        for what, *of in CASES[name]:
            machine = machines.setdefault(of[0], Machine()) if of else Machine()
            if what == "listen":
                machine.server = socket.create_server(("127.0.0.1", ports["listen"]))
                machine.server.settimeout(WAIT_S)
            elif what == "accept":
                assert machine.server is not None
                machine.connection = machine.server.accept()[0]
                machine.connection.settimeout(WAIT_S)
            elif what == "connect":
                machine.connection = station.connect(ports["connect"])
                machine.connection.settimeout(WAIT_S)
            elif what == "send":
                assert machine.connection is not None
                text = of[1].replace("{board}", board).replace("{x}", "x" * (of[2] if len(of) > 2 else 0))
                machine.connection.sendall(text.encode())
            elif what == "expect":
                board = machine.expect(of[1]) or board
            elif what == "reset":
                machine.expect_reset(of[1])
            elif what == "film":
                station.film()
            elif what == "close":
                machine.close()

"""`vaoi line send` plays either neighbour of a station, and says what went wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.hermes.station import PlayedStation, free_port
from vaoi_station.hermes import service


def test_both_neighbours_are_played_by_hand(vaoi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "RETRY_S", 0.05)
    above, below = (f"127.0.0.1:{free_port()}" for _ in range(2))
    steps = ("wait:MachineReady", "BoardAvailable:TopBarcode=A7,FailedBoard=2", "wait:StartTransport")
    with PlayedStation(tmp_path, upstream=above, listen=below, exit_s=0.1).running() as station:
        said = vaoi(
            "line", "send", "--as", "upstream", "--address", above, *steps, "TransportFinished", "wait:StopTransport"
        )
        assert said.code == 0, said.err
        assert "← StopTransport BoardId=" in said.out
        station.film()
        after = ("MachineReady", "wait:BoardAvailable", "StartTransport", "wait:TransportFinished", "StopTransport")
        said = vaoi("line", "send", "--as", "downstream", "--address", below, *after)
        assert said.code == 0, said.err
        assert "TopBarcode=A7" in said.out
        assert "FailedBoard=2" in said.out


def test_a_message_that_the_station_does_not_send_is_named(vaoi: Any, tmp_path: Path) -> None:
    port = free_port()
    with PlayedStation(tmp_path, listen=f"127.0.0.1:{port}").running() as station:
        station.connect(port).close()
        said = vaoi(
            "line",
            "send",
            "--as",
            "downstream",
            "--address",
            f"127.0.0.1:{port}",
            "--limit-s",
            "0.2",
            "wait:BoardAvailable",
        )
    assert said.code == 3
    assert "BoardAvailable did not come within 0.2 s" in said.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("Board",), "must be one of"),
        (("wait:Board",), "wait is 'Board'"),
        (("MachineReady", "--address", "127.0.0.1:99999"), "--address is '127.0.0.1:99999'"),
    ],
)
def test_what_is_no_step_is_refused(vaoi: Any, arguments: tuple[str, ...], words: str) -> None:
    said = vaoi("line", "send", "--as", "downstream", *arguments)
    assert said.code == 2
    assert words in said.err


def test_a_station_that_is_away_is_said(vaoi: Any) -> None:
    said = vaoi("line", "send", "--as", "downstream", "--address", f"127.0.0.1:{free_port()}", "MachineReady")
    assert said.code == 3
    assert "the station is not reached" in said.err

"""What another station replies is taken only if it is a board's document, is whole in time, and of this board."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from vaoi_station.api import other_station
from vaoi_station.api.other_station import OtherStation
from vaoi_station.errors import DeviceError
from vaoi_station.files.caller_credentials import caller_credentials

SIDE = {
    "side": "top", "run": "r/1", "address": "@evil/", "board_type": "b", "started": "2026-11-29T10:00:00.000Z",
    "verdict": "ok", "components": 3,
}  # fmt: skip
BOARD = {"board_id": "SN-1", "status": "ok", "top": SIDE}


@contextmanager
def replying(*pieces: bytes, pause_s: float = 0.0) -> Iterator[OtherStation]:
    """Serve one request with the pieces of a reply, behind the path of a proxy."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection, suppress(OSError):
            connection.recv(65536)
            for piece in pieces:
                connection.sendall(piece)
                time.sleep(pause_s)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}/upper"
        yield OtherStation(address, caller_credentials(None, None, environment={}))
    finally:
        thread.join()
        listener.close()


def reply(document: dict[str, Any]) -> bytes:
    content = json.dumps(document).encode()
    return b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%s" % (len(content), content)


def test_a_newer_station_with_more_fields_keeps_its_side_below_the_path_of_its_proxy() -> None:
    with replying(reply({**BOARD, "top": {**SIDE, "new": 1}, "new": 1})) as other:
        board = other.board("SN-1", 60.0)
    assert board is not None
    assert board.top is not None
    assert board.top.address == f"{other.address}/api/v1/runs/r%2F1"


@pytest.mark.parametrize(
    "document",
    [
        {**BOARD, "board_id": "SN-2"},
        {**BOARD, "top": {**SIDE, "started": "now"}},
        {**BOARD, "top": {**SIDE, "cad_matrix": [[0, 0, 0]] * 3}},
        {**BOARD, "top": {**SIDE, "cad_matrix": [[1, 0, 0], [0, 1, 0]]}},
    ],
)
def test_a_document_that_cannot_be_joined_counts_as_none(document: dict[str, Any]) -> None:
    with replying(reply(document)) as other, pytest.raises(DeviceError) as refusal:
        other.board("SN-1", 60.0)
    assert refusal.value.code == "other-station-silent"


def test_a_reply_that_comes_byte_by_byte_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(other_station, "TIMEOUT_S", 0.2)
    head = b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: 500\r\n\r\n"
    with (
        replying(head, *[b" "] * 500, pause_s=0.01) as other,
        pytest.raises(DeviceError, match="not complete after"),
    ):
        other.board("SN-1", 60.0)

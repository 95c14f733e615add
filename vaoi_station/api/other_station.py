"""The station that films the other side of the boards: asked for its runs of a board."""

from __future__ import annotations

import http.client
import json
import socket
import threading
from contextlib import suppress
from datetime import datetime
from urllib.parse import quote, urlencode, urlsplit

from pydantic import ValidationError

from vaoi_station.config import ApiConfig
from vaoi_station.errors import DeviceError
from vaoi_station.files.caller_credentials import CallerCredentials, caller_credentials
from vaoi_station.runs.board_sides import BoardDocument, BoardSide

TIMEOUT_S = 2.0
_MOST_BYTES = 20_000_000


class OtherStation:
    """Reads boards of another station. Its methods may be called from any thread."""

    def __init__(self, address: str, credentials: CallerCredentials) -> None:
        """Set the address, `http://HOST:PORT` or `https://HOST:PORT`, with the path of a proxy if there is one."""
        self.address, self._credentials, self._parts = address.rstrip("/"), credentials, urlsplit(address)

    @staticmethod
    def of(api: ApiConfig) -> OtherStation | None:
        """Return the station that the configuration names; InputError: its key or certificate cannot be read."""
        if api.other_station is None:
            return None
        credentials = caller_credentials(api.other_station_key, api.other_station_ca, environment={})
        return OtherStation(api.other_station, credentials)

    def board(self, board_id: str, within_s: float) -> BoardDocument | None:
        """Return what the station knows of a board by itself; None if it does not know it.

        Raise DeviceError if it does not reply in time, or not as a station of this version does.
        """
        query = urlencode({"within": within_s, "parts": "true", "alone": "true"})
        path = f"{self._parts.path.rstrip('/')}/api/v1/boards/{quote(board_id, safe='')}?{query}"
        try:
            status, content = self._get(path)
            if status == http.client.NOT_FOUND and json.loads(content).get("code") == "unknown-board":
                return None
            if status != http.client.OK:
                raise ValueError(f"status {status}")
            board = BoardDocument.model_validate_json(content, extra="ignore")
            if board.board_id != board_id:
                raise ValueError(f"it describes board {board.board_id!r}")
            for side in board.every_side:
                datetime.fromisoformat(side.started).timestamp()
            return self._addressed(board)
        except (OSError, http.client.HTTPException, ValidationError, ValueError, AttributeError) as error:
            why = "another document than expected" if isinstance(error, ValidationError) else str(error)
            raise DeviceError(
                f"The other station, {self.address}, does not report its runs: {why or type(error).__name__}.",
                action="Check that it runs, the network, and `other_station` of station.toml with its key.",
                code="other-station-silent",
            ) from error

    def _get(self, path: str) -> tuple[int, bytes]:
        host, port = self._parts.hostname or "", self._parts.port
        connection: http.client.HTTPConnection
        if self._parts.scheme == "https":
            context = self._credentials.tls_context()
            connection = http.client.HTTPSConnection(host, port, timeout=TIMEOUT_S, context=context)
        else:
            connection = http.client.HTTPConnection(host, port, timeout=TIMEOUT_S)
        connection.connect()
        # The time-out of a socket begins anew with each byte.
        late = threading.Event()
        end = threading.Timer(2 * TIMEOUT_S, _give_up, (connection.sock, late))
        end.daemon = True
        end.start()
        try:
            connection.request("GET", path, headers=self._credentials.headers())
            reply = connection.getresponse()
            content = reply.read(_MOST_BYTES)
            if late.is_set():
                raise TimeoutError(f"its reply is not complete after {2 * TIMEOUT_S:g} s")
            return reply.status, content
        finally:
            end.cancel()
            connection.close()

    def _addressed(self, board: BoardDocument) -> BoardDocument:
        """Return the document with whole addresses of its runs."""

        def whole(side: BoardSide) -> BoardSide:
            return side.model_copy(update={"address": f"{self.address}/api/v1/runs/{quote(side.run, safe='')}"})

        sides = {"top": board.top and whole(board.top), "bottom": board.bottom and whole(board.bottom)}
        return board.model_copy(update={**sides, "others": tuple(map(whole, board.others))})


def _give_up(connection: socket.socket, late: threading.Event) -> None:
    late.set()  # before the reader sees the end
    with suppress(OSError):  # It was closed meanwhile.
        connection.shutdown(socket.SHUT_RDWR)

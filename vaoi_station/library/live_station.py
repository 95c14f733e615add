"""A running station, used over REST (docs/rest.md): its line, its board types and its runs."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack
from urllib.parse import quote, urlsplit

from vaoi_station.demo.client import Client, unusable_reply
from vaoi_station.errors import InputError
from vaoi_station.files.caller_credentials import caller_credentials
from vaoi_station.library.arguments import require_number, require_path, require_text, require_whole
from vaoi_station.library.board_data import ImportChoices, StationImport
from vaoi_station.library.replies import RunIdReply, RunListReply, checked
from vaoi_station.library.station.station_board_types import StationBoardTypes
from vaoi_station.library.station.station_run import StationRun
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus
from vaoi_station.runs.states.decision_schemas import RunCounts

_PAGE = 500
"""Largest number of runs in one reply of a station."""


class RunFilters(TypedDict, total=False):
    """Which runs a caller wants; a run passes that passes every filter."""

    verdict: Literal["ok", "degraded", "failed", "none"]
    board_type: str
    board_id: str
    read_id: str
    reason: str
    since: str | datetime
    until: str | datetime
    before: str


class Station:
    """A connection to a running station. Every refusal is raised as the `VaoiError` that the station reports.

    Every method raises `DeviceError` with the address if the station does not reply, or replies with something else
    than a station of this version does.
    """

    def __init__(
        self,
        address: str,
        *,
        key: str | None = None,
        key_file: str | Path | None = None,
        ca: str | Path | None = None,
    ) -> None:
        """Set the address of the station, and how the caller is let in, as for `connect`. No request is sent yet."""
        if not isinstance(key, str | None):
            # The type only: a value of another type may still contain the key.
            raise InputError.field("connect", "key", type(key).__name__, "a text")
        credentials = caller_credentials(_path("key_file", key_file), _path("ca", ca), key=key)
        self._client = Client(checked_address(address), credentials)
        self.board_types = StationBoardTypes(self._client)
        """The board types of the station."""

    def snapshot(self) -> dict[str, Any]:
        """Return the present state of the station as `GET station` gives it."""
        reply = self._client.get("/station")
        if reply is None:
            raise unusable_reply(self._client.url("/station"), "no content")
        return dict(reply)

    def arm(
        self,
        board_type: str,
        *,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
        passing: Passing | None = None,
    ) -> dict[str, Any]:
        """Arm the line: film every board from now on, or only the next `runs` boards. Return the station's state.

        Args:
            board_type: name of the board type.
            board_id: the caller's id of the next board; it is repeated in the result.
            job_id: the caller's id of the job, likewise.
            runs: number of runs after which the line is disarmed; None: it stays armed.
            allow_lost_cameras: arm although cameras are missing.
            passing: while a board passes, which keeps the order before: "wait" until it has left (the default), take
                effect "after" it and return at once, or "refuse".

        Raises:
            NotFoundError: the station has no such board type.
            StateError: the line cannot be armed in the present state.
            BusyError: all memory is in use, or a camera is missing.
        """
        fields = {
            "board_type": require_text("arm", "board_type", board_type),
            "board_id": board_id,
            "job_id": job_id,
            "runs": None if runs is None else require_whole("arm", "runs", runs, 1, 1_000_000),
            "allow_lost_cameras": allow_lost_cameras or None,
            "passing": None if passing is None else require_text("arm", "passing", passing),
        }
        return self._command("/station/arm", {k: v for k, v in fields.items() if v is not None})

    def disarm(self) -> dict[str, Any]:
        """Disarm the line: film no further board. Return the station's state."""
        return self._command("/station/disarm", {})

    def events(self, after: int) -> Iterator[dict[str, Any]]:
        """Yield events numbered above `after`, and heartbeats, as they happen, until the station ends.

        `last_event` of `snapshot` is the number of the newest one.
        """
        yield from self._client.messages(require_whole("events", "after", after, 0, 2**53))

    def runs(self, limit: int = 50, **filters: Unpack[RunFilters]) -> list[dict[str, Any]]:
        """Return summaries of runs, newest first: the newest ones, or of those that all filters let pass.

        Args:
            limit: largest number of runs.
            **filters: `verdict` ("ok", "degraded", "failed", "none": without a result), `board_type`, `board_id` (the
                armed one), `read_id` (read from the board, or reported by the next machine), `reason` (a code or
                cause), `since` and `until` (times with a zone, RFC 3339 or datetime), `before` (id of a run).
        """
        missing = require_whole("runs", "limit", limit, 1, 1_000_000)
        query = _filters(filters)
        found: list[dict[str, Any]] = []
        # One reply has at most `_PAGE` runs, and with a filter it may have fewer although more follow.
        while missing > 0:
            reply = self._client.get("/runs", **query, limit=min(missing, _PAGE))
            page = checked(RunListReply, reply, self._client.url("/runs"))
            found += page.runs
            missing -= len(page.runs)
            if page.next is None:
                break
            query["before"] = page.next
        return found

    def counts(self, since: str | datetime | None = None) -> RunCounts:
        """Return the numbers of boards by verdict, and of missed ones, since a time; by default since midnight."""
        query = _filters({} if since is None else {"since": since})
        return checked(RunCounts, self._client.get("/runs/counts", **query), self._client.url("/runs/counts"))

    def calibration(self) -> CalibrationStatus:
        """Return the calibration in force, with the displacement of every camera from it in the latest runs."""
        return checked(CalibrationStatus, self._client.get("/calibration"), self._client.url("/calibration"))

    def run(self, run_id: str = "latest") -> StationRun:
        """Return a run by its id, by default the one that finished last."""
        path = f"/runs/{quote(require_text('run', 'run_id', run_id), safe='')}"
        return self._run(self._client.get(path), path)

    def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> StationRun | None:
        """Wait for the next finished run; return None if no run finishes in time.

        Args:
            after: id of the last run that the caller knows, so that no run is missed. By default the call returns the
                next run to finish.
            timeout_s: 0 to 60.
        """
        if after is not None:
            require_text("wait_for_run", "after", after)
        require_number("wait_for_run", "timeout_s", timeout_s, 0.0, 60.0)
        summary = self._client.get("/runs/next", after=after, timeout=timeout_s)
        return None if summary is None else self._run(summary, "/runs/next")

    def upload_board_data(
        self, path: str | Path, side: Literal["top", "bottom"] = "top", **choices: Unpack[ImportChoices]
    ) -> StationImport:
        """Send a file of a CAD system or placement machine to the station, which shows what it would make of it.

        Nothing is stored until `confirm` of the reply. Options are those of `import_board_data`.
        """
        return StationImport.upload(self._client, path, {"side": side, **choices})

    def _command(self, path: str, fields: dict[str, Any]) -> dict[str, Any]:
        reply = self._client.post(path, **fields)
        if reply is None:
            raise unusable_reply(self._client.url(path), "no content")
        return dict(reply)

    def _run(self, summary: Any, path: str) -> StationRun:
        return StationRun(checked(RunIdReply, summary, self._client.url(path)).id, dict(summary), self._client)


def connect(
    address: str = "http://127.0.0.1:8350",
    *,
    key: str | None = None,
    key_file: str | Path | None = None,
    ca: str | Path | None = None,
) -> Station:
    """Connect to a running station.

    Args:
        address: `http://HOST:PORT`, or `https://HOST:PORT` if the station has a certificate; with the path of a proxy
            such as `https://HOST/aoi`.
        key: the caller's key, needed from other machines than the station's. Better than a key in a program is a file.
        key_file: file that holds the key; by default the one that the environment variable VAOI_KEY_FILE names, or the
            key in VAOI_KEY.
        ca: PEM file with the certificate of the authority that signed the station's certificate, or with that
            certificate itself; by default that of VAOI_CA, else the authorities of the system.

    Raises:
        InputError: the address is not of this form, key or certificate cannot be read, or the station asks for a key or
            for one with another scope (codes `no-key`, `missing-scope`).
        DeviceError: no station replies at the address, or its certificate is not trusted.
    """
    station = Station(address, key=key, key_file=key_file, ca=ca)
    # One request now, so that a wrong address is an error here and not at the first use.
    station.snapshot()
    return station


def _filters(given: RunFilters) -> dict[str, str]:
    """Return filters as the parameters of a query; raise InputError for an unknown name or a wrong value."""
    query = {}
    for name, value in given.items():
        if name not in RunFilters.__annotations__:
            raise InputError.field("runs", name, value, f"one of {', '.join(RunFilters.__annotations__)}")
        if isinstance(value, datetime) and value.tzinfo is None:
            raise InputError.field("runs", name, str(value), "a time with its zone")
        query[name] = value.isoformat() if isinstance(value, datetime) else require_text("runs", name, value)
    return query


def _path(name: str, value: str | Path | None) -> Path | None:
    return None if value is None else require_path("connect", name, value)


def checked_address(address: str) -> str:
    """Return the address without a slash at its end; raise InputError if it is not `http://HOST:PORT`."""
    if not isinstance(address, str) or not address.startswith(("http://", "https://")):
        raise InputError(f"address is {address!r}, but must start with http:// or https://.")
    try:
        parts = urlsplit(address)
        sound = bool(parts.hostname) and parts.port != 0
    except ValueError:  # a malformed IPv6 address, or a port that is not a number
        sound = False
    # Such characters would end the line of the request, and with it begin another request.
    if not sound or not address.isascii() or any(c.isspace() or not c.isprintable() for c in address):
        raise InputError(f"address is {address!r}, but must be http://HOST:PORT, for example http://127.0.0.1:8350.")
    return address.rstrip("/")

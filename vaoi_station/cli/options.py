"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vaoi_station.demo.client import Client
    from vaoi_station.files.caller_credentials import CallerCredentials

CaseOf = Annotated[Path, typer.Argument(help="Recording (a directory).")]
ResultOf = Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")]
CalibrationOf = Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")]
BoardOf = Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")]
ReferenceOf = Annotated[Path | None, typer.Option(help="Use this reference, a directory written by `vaoi teach`.")]
RotationOf = Annotated[
    int | None, typer.Option(help="Expected rotation of the board: 0, 90, 180 or 270 degrees [recording.json].")
]
FlatFieldOf = Annotated[
    Path | None, typer.Option(help="Use the flat fields that `vaoi flatfield` wrote to this directory.")
]
ConfigOf = Annotated[Path, typer.Option(help="The station.toml of the station.")]
CONFIG = Path("station.toml")

# There is no option for the key itself: all users of a machine can read the arguments of its processes.
KeyFileOf = Annotated[
    Path | None,
    typer.Option(help="File with the caller's key [VAOI_KEY_FILE, or the key itself in VAOI_KEY].", show_default=False),
]
CaOf = Annotated[
    Path | None,
    typer.Option(help="PEM file with the trusted certificate of a station with TLS [VAOI_CA].", show_default=False),
]
StationOf = Annotated[
    str, typer.Option(envvar="VAOI_STATION", help="Address of the station, http://HOST:PORT or https://HOST:PORT.")
]
STATION = "http://127.0.0.1:8350"


def credentials_of(key_file: Path | None, ca: Path | None) -> CallerCredentials:
    """Return the credentials from the options, or from the environment."""
    from vaoi_station.files.caller_credentials import caller_credentials

    return caller_credentials(key_file, ca)


def client_of(station: str, key_file: Path | None, ca: Path | None) -> Client:
    """Return the client of a running station."""
    from vaoi_station.demo.client import Client
    from vaoi_station.library.live_station import checked_address

    return Client(checked_address(station), credentials_of(key_file, ca))

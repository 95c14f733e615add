"""The options of commands that call a running station: its address, the caller's key, the trusted certificate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vaoi_station.files.caller_credentials import CallerCredentials

# There is no option for the key itself: all users of a machine can read the arguments of its processes.
KEY_FILE = Annotated[
    Path | None,
    typer.Option(help="File with the caller's key [VAOI_KEY_FILE, or the key itself in VAOI_KEY].", show_default=False),
]
CA = Annotated[
    Path | None,
    typer.Option(help="PEM file with the trusted certificate of a station with TLS [VAOI_CA].", show_default=False),
]
STATION = Annotated[
    str, typer.Option(envvar="VAOI_STATION", help="Address of the station, http://HOST:PORT or https://HOST:PORT.")
]
DEFAULT_STATION = "http://127.0.0.1:8350"


def credentials_of(key_file: Path | None, ca: Path | None) -> CallerCredentials:
    """Return the credentials from the options, or from the environment."""
    from vaoi_station.files.caller_credentials import caller_credentials

    return caller_credentials(key_file, ca)

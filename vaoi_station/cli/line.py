"""The commands on the neighbours in the line: vaoi line send."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

app = typer.Typer(help="The neighbours in the line (IPC-HERMES-9852).", no_args_is_help=True)


class Part(StrEnum):
    """The machine that is played."""

    UPSTREAM = "upstream"
    DOWNSTREAM = "downstream"


@app.callback()
def line() -> None:
    """Group the commands on the neighbours in the line."""


@app.command()
def send(
    messages: Annotated[
        list[str],
        typer.Argument(
            help="Messages in turn, such as BoardAvailable:ProductTypeId=P1,FailedBoard=2 or wait:StopTransport."
        ),
    ],
    *,
    part: Annotated[
        Part, typer.Option("--as", help="Play the machine upstream, to which the station connects, or the next one.")
    ],
    address: Annotated[
        str | None,
        typer.Option(help="Listen there (upstream) or connect there; default: this machine, 50100 plus lane."),
    ] = None,
    lane: Annotated[int, typer.Option(min=1, max=99, help="Number of the lane.")] = 1,
    limit_s: Annotated[float, typer.Option(min=0.1, max=3600, help="Longest wait for the station, s.")] = 30.0,
) -> None:
    """Play a neighbour of a station: send messages by hand, and print what the station answers.

    What a message must have and is not given is filled in; all messages of one call are about one board.
    """
    from vaoi_station.errors import InputError
    from vaoi_station.hermes.neighbour import PlayedNeighbour
    from vaoi_station.line_config import HERMES_PORT

    host, _, port = (address or "127.0.0.1").partition(":")
    if port and not (port.isdigit() and 1 <= int(port) <= 65_535):
        raise InputError.field("line send", "--address", address, "a host, or host and port such as 127.0.0.1:50101")
    at = host, int(port) if port else HERMES_PORT + lane
    PlayedNeighbour("sender" if part is Part.UPSTREAM else "receiver", at, lane, limit_s, typer.echo).play(messages)

"""`vaoi view --config station.toml`: show live frames with focus, exposure and marks."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vaoi_station.config import StationConfig


class Mark(StrEnum):
    """The shapes of marks."""

    CROSS = "cross"
    CIRCLE = "circle"
    SQUARE = "square"
    DIAMOND = "diamond"


def view(
    config: Annotated[Path, typer.Option(help="Read cameras, controller and line from this station.toml.")],
    *,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page, on loopback; 0: any free one.")] = 8351,
    mark: Annotated[Mark | None, typer.Option(help="Search for marks of this shape; needs --mark-size-mm.")] = None,
    mark_size_mm: Annotated[float | None, typer.Option(min=0.01, max=1000, help="Size of a mark.")] = None,
    layout: Annotated[
        Path | None, typer.Option(help="Read shape and size of the marks from this layout of a calibration board.")
    ] = None,
    px_per_mm: Annotated[
        float | None,
        typer.Option(min=0.1, max=10000, help="Resolution [that of the calibration, else the nominal one]."),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=0.1, max=10, help="Fire this number of pulses per second, without the light barrier.")
    ] = 2.0,
    boards: Annotated[bool, typer.Option("--boards", help="Film boards that pass the light barrier instead.")] = False,
    once: Annotated[bool, typer.Option("--once", help="Film once, print the figures of one row, and exit.")] = False,
    row: Annotated[int | None, typer.Option(min=0, help="With --once --boards: use this row [the middle one].")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="With --once: print one JSON document.")] = False,
) -> None:
    """Show live frames of every camera, for mounting and focusing, until Ctrl-C.

    While the station runs, it has the cameras: its page shows the same cards of the frames that it films.
    """
    from vaoi_station.config import read_config
    from vaoi_station.demo.signal_handling import INTERRUPTED, interruptible
    from vaoi_station.errors import InputError
    from vaoi_station.viewing.frame_documents import row_text
    from vaoi_station.viewing.live_view import one_row, show
    from vaoi_station.viewing.mark_spec import mark_specs

    if not once and as_json:
        raise InputError("--json needs --once.", action="Add --once, or omit --json.")
    if row is not None and not (once and boards):
        raise InputError("--row needs --once and --boards.", action="Add both, or omit --row.")
    station = read_config(config)
    if not once and (address := _running_station(station)) is not None:
        print(f"The station runs and has the cameras. Its page shows them: {address}/#/cameras", flush=True)
        print("To film without boards, stop the station first (systemctl stop vaoi-station).", flush=True)
        return
    specs = mark_specs(station, mark.value if mark else None, mark_size_mm, layout, px_per_mm)
    rate_hz = None if boards else rate
    code = 0
    try:
        with interruptible():
            if once:
                figures = one_row(station, specs, row, lambda sentence: print(sentence, file=sys.stderr), rate_hz)
                print(json.dumps(figures, indent=1) if as_json else row_text(figures))
            else:
                show(station, specs, port, lambda sentence: print(sentence, flush=True), rate_hz)
    except KeyboardInterrupt:
        # Ctrl-C is the normal end of the live view, but it cuts a single measurement short.
        code = INTERRUPTED if once else 0
    raise typer.Exit(code)


def _running_station(config: StationConfig) -> str | None:
    """Return the address of the station of this configuration if it runs and replies; None otherwise."""
    from vaoi_station.doctor.checks.running_station import find
    from vaoi_station.doctor.station_connection import address_of

    process = find(config)
    if process is None or not process.snapshot:
        return None
    host, port = address_of(config.api)
    return f"http{'' if config.api.certificate is None else 's'}://{host}:{port}"

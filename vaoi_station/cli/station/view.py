"""`vaoi view --config station.toml`: live frames with focus, exposure and marks."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Mark(StrEnum):
    """Shapes of marks."""

    CROSS = "cross"
    CIRCLE = "circle"
    SQUARE = "square"
    DIAMOND = "diamond"


def view(
    config: Annotated[Path, typer.Option(help="station.toml: cameras, controller and line.")],
    *,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page, on loopback; 0: any free one.")] = 8351,
    mark: Annotated[Mark | None, typer.Option(help="Marks to look for; with --mark-size-mm.")] = None,
    mark_size_mm: Annotated[float | None, typer.Option(min=0.01, max=1000, help="Size of a mark.")] = None,
    layout: Annotated[Path | None, typer.Option(help="Of the calibration board: what its marks are like.")] = None,
    px_per_mm: Annotated[
        float | None, typer.Option(min=0.1, max=10000, help="By default that of the calibration, else the nominal one.")
    ] = None,
    rate: Annotated[
        float, typer.Option(min=0.1, max=10, help="Pulses per second, fired whether a board passes or not.")
    ] = 2.0,
    boards: Annotated[bool, typer.Option("--boards", help="Film boards that pass the light barrier instead.")] = False,
    once: Annotated[bool, typer.Option("--once", help="Film once, tell the figures of one row, and end.")] = False,
    row: Annotated[int | None, typer.Option(min=0, help="With --once --boards: which row [the middle one].")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="With --once: print one JSON document.")] = False,
) -> None:
    """Show live frames of every camera, for mounting and focusing, until Ctrl-C."""
    from vaoi_station.config import read_config
    from vaoi_station.demo.signal_handling import INTERRUPTED, interruptible
    from vaoi_station.errors import InputError
    from vaoi_station.viewing.frame_documents import row_text
    from vaoi_station.viewing.live_view import one_row, show
    from vaoi_station.viewing.mark_spec import mark_specs

    if not once and as_json:
        raise InputError("--json belongs to --once.", action="Add --once, or leave it out.")
    if row is not None and not (once and boards):
        raise InputError("--row belongs to --once --boards.", action="Add both, or leave it out.")
    station = read_config(config)
    specs = mark_specs(station, mark.value if mark else None, mark_size_mm, layout, px_per_mm)
    rate_hz = None if boards else rate
    code = 0
    try:
        with interruptible():
            if once:
                told = one_row(station, specs, row, lambda sentence: print(sentence, file=sys.stderr), rate_hz)
                print(json.dumps(told, indent=1) if as_json else row_text(told))
            else:
                show(station, specs, port, lambda sentence: print(sentence, flush=True), rate_hz)
    except KeyboardInterrupt:
        code = INTERRUPTED if once else 0
    raise typer.Exit(code)

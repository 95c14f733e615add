"""`vaoi doctor --config station.toml`: check everything that a station needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from vaoi_station.cli.station.station_access import CA, KEY_FILE, credentials_of


def doctor(
    config: Annotated[Path, typer.Option(help="Check the station of this station.toml.")] = Path("station.toml"),
    *,
    key_file: KEY_FILE = None,
    ca: CA = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    toggle_line_ready: Annotated[
        bool, typer.Option(help="Switch the output 'line ready' three times instead: stop the conveyor first.")
    ] = False,
) -> None:
    """Check machine, files and devices, and propose an action for each problem.

    Nothing is changed, except by --toggle-line-ready. Exit code: 0 without problems, 1 with warnings, 2 with faults.
    """
    if toggle_line_ready:
        from vaoi_station.config import read_config
        from vaoi_station.doctor.controller_checks import toggle_line_output

        toggle_line_output(read_config(config).controller, typer.echo)
        return
    from vaoi_station.doctor import run_checks
    from vaoi_station.doctor.finding import as_text

    report = run_checks(config, credentials=credentials_of(key_file, ca))
    typer.echo(json.dumps(report.document(), indent=1) if as_json else as_text(report), nl=as_json)
    raise typer.Exit(report.exit_code)

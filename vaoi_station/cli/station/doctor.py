"""`vaoi doctor --config station.toml`: is everything there that a station needs?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer


def doctor(
    config: Annotated[Path, typer.Option(help="The station's configuration.")] = Path("station.toml"),
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Look at machine, files and devices; tell what is wrong and what to do. Changes nothing.

    Exit code 0: nothing to do, 1: warnings, 2: faults.
    """
    from vaoi_station.doctor import run_checks
    from vaoi_station.doctor.text_report import as_text

    report = run_checks(config)
    typer.echo(json.dumps(report.document(), indent=1) if as_json else as_text(report), nl=as_json)
    raise typer.Exit(report.exit_code)

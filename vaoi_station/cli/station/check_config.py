"""`vaoi check-config station.toml`: state everything that is wrong in the file at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def check_config(
    file: Annotated[Path, typer.Argument(help="The station.toml to check.")] = Path("station.toml"),
) -> None:
    """Check every key of a station.toml and every file it names; state all faults at once. No device is opened.

    The exit code is 0 without problems, 1 with warnings, 2 with faults.
    """
    from vaoi_station.doctor.finding import EXIT_CODES, problems_as_text
    from vaoi_station.doctor.runner import check_config as check

    findings = check(file)
    typer.echo(problems_as_text(file, findings))
    raise typer.Exit(max(EXIT_CODES[finding.level] for finding in findings))

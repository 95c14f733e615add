"""`vaoi bundle --config station.toml`: collect what a developer needs to understand a fault."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vaoi_station.cli.station.station_access import CA, KEY_FILE, credentials_of


def bundle(
    config: Annotated[Path, typer.Option(help="Describe the station of this station.toml.")] = Path("station.toml"),
    out: Annotated[Path, typer.Option(help="Write this file.")] = Path("vaoi-support.tar.gz"),
    key_file: KEY_FILE = None,
    ca: CA = None,
) -> None:
    """Write log, configuration, findings of the doctor and state of the station into one file, without secrets."""
    from vaoi_station.doctor.support_bundle import write_support_bundle

    made = write_support_bundle(config, out, credentials_of(key_file, ca))
    typer.echo(f"{out}: {len(made.members)} files, without pictures, layouts and secrets. Read it before you send it.")
    for name, cause in made.missing.items():
        typer.echo(f"{name}: {cause}", err=True)

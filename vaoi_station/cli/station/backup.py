"""`vaoi backup` and `vaoi restore`: everything of a station in one file, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def backup(
    file: Annotated[Path, typer.Argument(help="Write the backup to this file, which must not exist.")],
    config: Annotated[Path, typer.Option(help="Back up the station of this station.toml.")] = Path("station.toml"),
    recordings: Annotated[
        bool, typer.Option("--recordings", help="Include the kept recordings of frames; they may have many gigabytes.")
    ] = False,
) -> None:
    """Write configuration, calibration, board types, references and history to one file; the station may be running."""
    from vaoi_station.transfer.backup import back_up

    summary = back_up(config, file, recordings=recordings)
    typer.echo(f"{file}: {summary.files} files, {summary.size_bytes / 1e6:.1f} MB")
    if summary.deleted:
        typer.echo(f"without recordings that the station deleted meanwhile: {', '.join(summary.deleted)}")


def restore(
    file: Annotated[Path, typer.Argument(help="The backup.")],
    config: Annotated[
        Path, typer.Option(help="Write station.toml here, and the other files to where it says; none may exist.")
    ] = Path("station.toml"),
) -> None:
    """Restore a backup where no station is. Nothing is written before the whole backup was checked."""
    from vaoi_station.transfer.absent_files import absent_files
    from vaoi_station.transfer.backup import restore as restore_backup

    station = restore_backup(file, config)
    typer.echo(f"{config}: station {station.name!r} is restored; its data are in {station.data}")
    for key, path in absent_files(station):
        typer.echo(f"not in the backup, put it back: {path} ({key})")

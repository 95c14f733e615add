"""`vaoi export`, and `vaoi import` of such a file: one run as one file, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    run: Annotated[str, typer.Argument(help="Id of the run.")],
    out: Annotated[Path, typer.Option(help="Write the run to this file, which must not exist.")],
    config: Annotated[Path, typer.Option(help="Export from the station of this station.toml.")] = Path("station.toml"),
) -> None:
    """Write a run to one file: result, record, calibration, board type, and frames if they were kept."""
    from vaoi_station.transfer.run_export import export_run

    recorded = export_run(config, run, out)
    typer.echo(f"{out}: run {run} {'with' if recorded else 'without'} frames")


def import_exported_run(file: Path, out: Path | None, config: Path | None) -> None:
    """Unpack an exported run into a directory, or put it into the history of a station."""
    from vaoi_station.errors import InputError
    from vaoi_station.transfer.run_export import import_run
    from vaoi_station.transfer.run_import import import_into_history

    if (out is None) == (config is None):
        raise InputError("import needs either --out or --config.", action="Give exactly one of them.")
    if config is not None:
        imported = import_into_history(file, config)
        frames = "with frames" if imported.with_frames else "without frames"
        origin = imported.detail.origin
        typer.echo(f"{config}: run {imported.detail.id} of {origin.station if origin else ''!r}, {frames}, pinned")
        return
    assert out is not None, "one of the two is given"
    detail = import_run(file, out)
    typer.echo(f"{out}: run {detail.id} of board type {detail.board_type!r}, {detail.verdict}")

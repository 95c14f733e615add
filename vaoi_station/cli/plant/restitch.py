"""`vaoi restitch ARCHIVE… --out DIR`: stitch archived runs again, on many processes or machines."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vaoi_station.cli.plant.selection import (
    Archives,
    BoardTypeName,
    Dashboard,
    Memory,
    Patience,
    Scheduler,
    Since,
    Station,
    Until,
    Workers,
    progress_bar,
    run_selection,
)

if TYPE_CHECKING:
    from vaoi_station.plant.restitch import Summary

INCOMPLETE = 1
"""Exit code if runs or workers were left out. Each is named on stderr."""
INTERRUPTED = 130


def restitch(
    archives: Archives,
    out: Annotated[Path, typer.Option(help="Directory of the data set; that of an earlier call goes on.")],
    scheduler: Scheduler = None,
    workers: Workers = None,
    board_type: BoardTypeName = None,
    since: Since = None,
    until: Until = None,
    station: Station = None,
    verdict: Annotated[str | None, typer.Option(help="Only runs with this verdict: ok, degraded or failed.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [that of each run].")] = None,
    board: Annotated[
        Path | None,
        typer.Option(help="Use this board type, a file, for the runs of its name or --board-type [that of each run]."),
    ] = None,
    method: Annotated[
        Literal["auto", "fiducials", "features", "reference"] | None,
        typer.Option(help="Use this evidence [that of each run]."),
    ] = None,
    memory: Memory = 2000,
    dashboard: Dashboard = None,
    patience: Patience = 30.0,
) -> None:
    """Stitch archived runs again; write a Parquet data set, and a report of what changed.

    A call that was interrupted goes on when it is repeated. Exit code 1: something was left out, which is named.
    """
    from vaoi_station.files import read_board_type, read_calibration
    from vaoi_station.plant.restitch import ClusterOptions, Session, Terms, restitch
    from vaoi_station.plant.workers.software import software

    options = ClusterOptions(scheduler, workers, memory, dashboard, patience)
    options.check()
    # Read here, so that a fault of these files is reported once, and before any run is stitched.
    if calibration is not None:
        read_calibration(calibration)
    if board is not None:
        # Unless stated otherwise it replaces that of its name: other runs show other boards.
        name = read_board_type(board).name
        board_type = board_type or name
    selection = run_selection(board_type, since, until, station, verdict)
    terms = Terms(software(), _content(calibration), _content(board), method)
    typer.echo(f"software: {terms.software}")
    with progress_bar("runs") as progress:
        session = Session(
            archives, selection, terms, out, progress, lambda text: typer.echo(text, err=True), typer.echo
        )
        try:
            summary = restitch(session, options)
        except KeyboardInterrupt:
            typer.echo("\nInterrupted: what is done stays done. Repeat the command to go on.", err=True)
            raise typer.Exit(INTERRUPTED) from None
    _show(summary, out)
    if summary.left_out:
        raise typer.Exit(INCOMPLETE)


def _content(path: Path | None) -> bytes | None:
    return None if path is None else path.read_bytes()


def _show(summary: Summary, out: Path) -> None:
    from vaoi_station.plant.restitch.session import FAULTS, REPORT, TABLES, UNEQUAL

    changes = summary.changes
    typer.echo(f"{summary.done} of {summary.runs} runs stitched, {summary.stitched} by this call → {out / TABLES}")
    typer.echo(f"{changes.changed_boards} of {changes.runs} runs changed by more than σ → {out / REPORT}")
    for camera in changes.cameras[:3]:
        if camera.changed:
            typer.echo(
                f"station {camera.station}, camera {camera.camera}: displacement changed by {camera.size_px:.3f} px in "
                f"{camera.changed} of {camera.runs} runs"
            )
    for note, runs in summary.unequal.items():
        typer.echo(f"{len(runs)} runs were stitched otherwise than by their station (see {out / UNEQUAL}): {note}")
    if summary.left_out:
        typer.echo(f"{len(summary.left_out)} left out; see {out / FAULTS}")

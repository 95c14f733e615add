"""`vaoi dataset ARCHIVE… --components 'C*,R*' --out DIR`: crops of components as a data set for training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from vaoi_station.cli.plant.restitch import INCOMPLETE
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
    verdicts_of,
)
from vaoi_station.cli.recordings.cut_images import Align, Light, Margin


def dataset(
    archives: Archives,
    out: Annotated[Path, typer.Option(help="Create this directory.")],
    components: Annotated[
        str, typer.Option(help="References or addresses, or patterns with * and ?, separated by commas.")
    ] = "*",
    format_: Annotated[Literal["coco", "webdataset"], typer.Option("--format", help="Format.")] = "coco",
    board_type: BoardTypeName = None,
    since: Since = None,
    until: Until = None,
    station: Station = None,
    verdict: Annotated[str, typer.Option(help="Only runs with one of these verdicts, separated by commas.")] = "ok",
    splits: Annotated[str, typer.Option(help="Splits with their shares of the boards.")] = "train=0.8,val=0.1,test=0.1",
    light: Light = None,
    margin: Margin = 0.0,
    align: Align = "cad",
    px_per_mm: Annotated[float | None, typer.Option(help="Resolution [that of the cameras].")] = None,
    limit: Annotated[int | None, typer.Option(help="Largest number of crops of a component of a run [all].")] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    memory: Memory = 2000,
    dashboard: Dashboard = None,
    patience: Patience = 30.0,
) -> None:
    """Cut components out of archived runs, with everything that is known about each crop.

    Splits are by board, never by crop. Equal selections give equal bytes, with any number of workers; without
    --scheduler and --workers the work is done by this process. Exit code 1: runs were left out by a fault,
    which is named.
    """
    from vaoi_station.plant.datasets import CropOptions, DatasetTerms, Listener, Splits, write_dataset
    from vaoi_station.plant.workers import ClusterOptions
    from vaoi_station.rendering import ImageOptions, ImageRequest

    images = ImageOptions(light=light, margin_mm=margin, align=align, px_per_mm=px_per_mm, limit=limit)
    terms = DatasetTerms(
        Splits.of(splits),
        CropOptions(tuple(part.strip() for part in components.split(",")), ImageRequest.of(images)),
        run_selection(board_type, since, until, station, None),
        verdicts_of(verdict),
        format_,
    )
    here = scheduler is None and workers is None
    cluster = None if here else ClusterOptions(scheduler, workers, memory, dashboard, patience)
    with progress_bar("runs") as progress:
        listener = Listener(progress, lambda text: typer.echo(text, err=True), typer.echo)
        summary = write_dataset(archives, terms, out, cluster, listener)
    counts = ", ".join(f"{split} {count}" for split, count in summary.crops.items())
    typer.echo(f"{sum(summary.crops.values())} crops of {summary.runs} runs ({counts}) → {out}")
    if summary.empty:
        typer.echo(f"{summary.empty} of them show a place without a component")
    if summary.other_verdicts:
        typer.echo(f"{summary.other_verdicts} runs have another verdict than {verdict} and were left out")
    if summary.left_out:
        typer.echo(f"{len(summary.left_out)} left out by a fault")
        raise typer.Exit(INCOMPLETE)

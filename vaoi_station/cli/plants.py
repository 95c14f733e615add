"""`vaoi restitch` and `vaoi dataset`: archived runs stitched again, or cut to crops, on many processes or machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vaoi_station.cli.cutting import Align, Light, Margin

if TYPE_CHECKING:
    from vaoi_station.model import Status
    from vaoi_station.plant.archive import RunSelection
    from vaoi_station.plant.restitch import Summary

Archives = Annotated[list[str], typer.Argument(help="Archives: directories, or addresses such as s3://bucket/path.")]
BoardTypeName = Annotated[
    str | None, typer.Option("--board-type", help="Only runs of this board type, a name or a pattern with * and ?.")
]
Since = Annotated[str | None, typer.Option(help="Only runs from this day or time (UTC) on.")]
Until = Annotated[str | None, typer.Option(help="Only runs up to this day (included), or before this time (UTC).")]
Station = Annotated[str | None, typer.Option(help="Only runs of this station, a name or a pattern with * and ?.")]
Scheduler = Annotated[str | None, typer.Option(help="Use the workers of this Dask scheduler.")]
Workers = Annotated[int | None, typer.Option(help="Use this number of processes of this machine.")]
Memory = Annotated[int, typer.Option(min=300, max=1_000_000, help="With --workers: limit of the memory of each, MB.")]
Dashboard = Annotated[
    str | None, typer.Option(help="With --workers: serve Dask's dashboard here, such as 127.0.0.1:8787.")
]
Patience = Annotated[
    float, typer.Option(min=1, max=3600, help="Longest wait for the scheduler and for usable workers, s.")
]


def run_selection(
    board_type: str | None, since: str | None, until: str | None, station: str | None, verdict: str | None
) -> RunSelection:
    """Make a selection from the options. Raise InputError if one is outside its limits."""
    from vaoi_station.errors import InputError
    from vaoi_station.plant.archive import RunSelection

    verdicts = () if verdict is None else verdicts_of(verdict)
    if len(verdicts) > 1:
        raise InputError.field("selection", "--verdict", verdict, "one verdict")
    return RunSelection(board_type, since, until, station, verdicts[0] if verdicts else None)


def verdicts_of(text: str) -> tuple[Status, ...]:
    """Return the verdicts that a text names, separated by commas. Raise InputError if it has other words."""
    from vaoi_station.errors import InputError
    from vaoi_station.model import Status

    words = [word.strip() for word in text.split(",")]
    known = [status.value for status in Status]
    if not set(words) <= set(known):
        raise InputError.field("selection", "--verdict", text, "one of " + ", ".join(known))
    return tuple(Status(word) for word in words)


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that shows how many of all runs are done; on a terminal as a bar."""
    bar = None

    def show(done: int, runs: int) -> None:
        nonlocal bar
        if bar is None:
            bar = typer.progressbar(length=runs, label=label, show_pos=True)
            bar.__enter__()
        bar.length = runs  # It falls while manifests are read of runs that are not selected.
        bar.update(done - bar.pos)

    try:
        yield show
    finally:
        if bar is not None:
            bar.__exit__(None, None, None)


INCOMPLETE = 1
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
    from vaoi_station.plant.cluster import ClusterOptions, software
    from vaoi_station.plant.restitch import Session, Terms, restitch

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
    from vaoi_station.plant.restitch import FAULTS, REPORT, TABLES, UNEQUAL

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
    from vaoi_station.plant.cluster import ClusterOptions
    from vaoi_station.plant.datasets import CropOptions, DatasetTerms, Listener, Splits, write_dataset
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

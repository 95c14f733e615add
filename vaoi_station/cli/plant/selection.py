"""The options by which commands select runs of archives and a cluster, and a bar that shows their progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vaoi_station.model import Status
    from vaoi_station.plant.archive import RunSelection

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

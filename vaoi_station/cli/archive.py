"""`vaoi archive …`: finished runs of many stations in one archive."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vaoi_station.cli.plants import BoardTypeName, Since, Station, Until, run_selection
from vaoi_station.errors import InputError, NotFoundError

if TYPE_CHECKING:
    from vaoi_station.plant.manifest import OnFault

SAFE_GRACE_HOURS = 19.0
"""Shortest age that is safe while runs are added: an addition of at most 6 h relies on blobs younger than 12 h,
and the clocks of machines and storage may differ by 1 h."""
FAULTS = 1
"""Exit code if something of an archive could not be used; the rest was done."""
app = typer.Typer(
    help="Finished runs of many stations: losslessly compressed, nothing stored twice, verified by checksums.",
    no_args_is_help=True,
)
_Archive = Annotated[str, typer.Argument(help="Directory, or an address that fsspec knows (s3://bucket/folder).")]
_Verdict = Annotated[str | None, typer.Option(help="Only runs with this verdict: ok, degraded or failed.")]


@app.command()
def create(archive: _Archive) -> None:
    """Make a new, empty archive."""
    from vaoi_station.plant.archive import Archive

    typer.echo(f"{Archive.create(archive).url}: the archive is ready.")


@app.command()
def add(
    archive: _Archive,
    recordings: Annotated[list[Path], typer.Argument(help="Recordings (directories).")],
    station: Annotated[str, typer.Option(help="Name of the station that filmed them.")] = "unnamed",
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [each calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [each board.json].")] = None,
    run: Annotated[str | None, typer.Option(help="Id of the run, for one recording [as the station gave it].")] = None,
    time: Annotated[str | None, typer.Option(help="Begin of the run in UTC [as the recording says].")] = None,
) -> None:
    """Add recordings; one that cannot be added is named, and the others are added."""
    from vaoi_station.plant.archive import Archive, RunLabel
    from vaoi_station.plant.manifest import ArchiveFault

    if run is not None and len(recordings) > 1:
        raise InputError.field("vaoi archive add", "--run", run, "given for one recording only")
    opened = Archive.open(archive)
    faults, report = _faults()
    for recording in recordings:
        try:
            added = opened.add(
                recording, calibration=calibration, board_type=board, station=station, label=RunLabel(run, time)
            )
        except (InputError, NotFoundError) as error:
            report(ArchiveFault.of(error))
            continue
        typer.echo(f"{recording} → run {added.run}, {added.bytes / 1e6:.1f} MB, {added.pixels / 1e6:.1f} Mpx")
    _exit(faults)


@app.command(name="list")
def list_runs(
    archive: _Archive,
    board_type: BoardTypeName = None,
    since: Since = None,
    until: Until = None,
    station: Station = None,
    verdict: _Verdict = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """List runs by station and time."""
    from vaoi_station.plant.archive import Archive

    faults, report = _faults()
    for run in Archive.open(archive).runs(run_selection(board_type, since, until, station, verdict), report):
        if json:
            shown = run.model_dump(mode="json", exclude={"documents", "frames", "format", "version"})
            typer.echo(json_module.dumps(shown | {"frames": len(run.frames), "bytes": run.bytes}))
        else:
            verdict_text = run.verdict or "-"
            size = f"{len(run.frames):4d} frames {run.bytes / 1e6:8.1f} MB"
            typer.echo(f"{run.run}  {run.time}  {run.station}  {run.board_type}  {verdict_text}  {size}")
    _exit(faults)


@app.command()
def verify(
    archive: _Archive,
    board_type: BoardTypeName = None,
    since: Since = None,
    until: Until = None,
    station: Station = None,
    verdict: _Verdict = None,
) -> None:
    """Compare every blob with its checksum; name what is missing, damaged, half written or there twice."""
    from vaoi_station.plant.archive import Archive

    faults, report = _faults()
    found = Archive.open(archive).verify(run_selection(board_type, since, until, station, verdict), report)
    typer.echo(
        f"{found.runs} runs, {found.blobs} blobs, {found.bytes / 1e6:.1f} MB read: "
        f"{found.damaged_runs} runs damaged, {found.faults} faults."
    )
    _exit(faults)


@app.command()
def restore(
    archive: _Archive,
    out: Annotated[Path, typer.Option(help="Directory in which each run becomes a recording, named by its id.")],
    run: Annotated[str | None, typer.Option(help="Only the run with this id.")] = None,
    board_type: BoardTypeName = None,
    since: Since = None,
    until: Until = None,
    station: Station = None,
    verdict: _Verdict = None,
) -> None:
    """Write runs out as recordings, with all that `vaoi stitch`, `report` and `cut` need; existing ones are skipped."""
    from vaoi_station.plant.archive import Archive

    opened = Archive.open(archive)
    if run is not None:
        typer.echo(f"{opened.extract(run, out / run)}")
        return
    faults, report = _faults()
    for restored in opened.restore(out, run_selection(board_type, since, until, station, verdict), report):
        typer.echo(f"{out / restored.run}")
    _exit(faults)


@app.command()
def prune(
    archive: _Archive,
    run: Annotated[list[str] | None, typer.Option(help="Remove the run with this id, also if it is damaged.")] = None,
    board_type: BoardTypeName = None,
    until: Until = None,
    station: Station = None,
    verdict: _Verdict = None,
    grace_hours: Annotated[
        float, typer.Option(min=0.0, help="Keep blobs without a run that were written less than this ago.")
    ] = 24.0,
    nothing_added: Annotated[
        bool, typer.Option("--nothing-added", help="State that no run is being added: allows less than 19 hours.")
    ] = False,
    confirm: Annotated[bool, typer.Option("--confirm", help="Remove; without it, only count.")] = False,
) -> None:
    """Remove the selected runs, and what no run needs. Without a selection no run is removed."""
    from vaoi_station.plant.archive import Archive

    for name, given in (("--board-type", board_type), ("--until", until), ("--verdict", verdict)):
        if run and given is not None:
            raise InputError.field("vaoi archive prune", name, given, "absent beside --run, which removes runs by id")
    if grace_hours < SAFE_GRACE_HOURS and not nothing_added:
        raise InputError.field(
            "vaoi archive prune",
            "--grace-hours",
            grace_hours,
            f"at least {SAFE_GRACE_HOURS:g}",
            "A run that is being added may need younger blobs; if none is being added, give --nothing-added as well.",
        )
    chosen = any(given is not None for given in (board_type, until, station, verdict))
    selection = run_selection(board_type, None, until, station, verdict) if chosen else None
    faults, report = _faults()
    pruned = Archive.open(archive).prune(
        selection, ids=frozenset(run or ()), grace_s=3600 * grace_hours, dry=not confirm, on_fault=report
    )
    done = "removed" if confirm else "would be removed (--confirm removes)"
    typer.echo(
        f"{pruned.runs} runs, {pruned.blobs} blobs, {pruned.drafts} runs half written, {pruned.leftovers} unfinished "
        f"files, {pruned.bytes / 1e6:.1f} MB {done}. "
        f"Blobs of runs that were just removed may stay for {grace_hours:g} hours."
    )
    _exit(faults)


def _faults() -> tuple[list[object], OnFault]:
    """Return a list of faults, and a function that prints and lists each."""
    faults: list[object] = []

    def report(fault: object) -> None:
        faults.append(fault)
        typer.echo(f"vaoi: {fault}", err=True)

    return faults, report


def _exit(faults: list[object]) -> None:
    if faults:
        raise typer.Exit(FAULTS)

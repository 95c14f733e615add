"""The commands on a station: serve, record, check-config, doctor, bundle, backup, restore, export, import."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from vaoi_station.cli.options import CONFIG, CaOf, ConfigOf, KeyFileOf, credentials_of


def serve(
    config: ConfigOf = CONFIG,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Listen at this port instead of the configured one; 0: any free one."),
    ] = None,
    log_json: Annotated[bool, typer.Option("--log-json", help="Log JSON objects, one per line.")] = False,
) -> None:
    """Film boards, stitch them, and serve results by REST, until Ctrl-C or SIGTERM."""
    from vaoi_station.runs.host.processes import no_collections

    with no_collections():
        from vaoi_station import station
        from vaoi_station.acquisition.process.backends import check_backends
        from vaoi_station.config import read_config
        from vaoi_station.runs.host.logs import configure_logging
        from vaoi_station.runs.host.processes import set_process_title

    settings = read_config(config)
    # Checked before processes start: a wrong scenario gives one error here, but would give endless restarts later.
    check_backends(settings)
    set_process_title("vaoi", arguments=False)
    configure_logging(log_json)
    station.serve(settings, port, config)


STILL_RATE_HZ = 1.0


def record(
    config: Annotated[Path, typer.Option(help="Read cameras, controller and line from this station.toml.")],
    out: Annotated[
        Path, typer.Option(help="Write the recording to this directory; several runs to its subdirectories run-001 ….")
    ],
    runs: Annotated[int, typer.Option(min=1, help="Film this number of boards.")] = 1,
    still: Annotated[
        bool, typer.Option("--still", help="Fire one pulse at once, without the light barrier: a board at rest.")
    ] = False,
) -> None:
    """Film boards with the configured devices and keep each as a recording."""
    from vaoi_station.acquisition.process.filming import FilmingHandlers, export_run, film, film_pulses
    from vaoi_station.acquisition.process.messages import RunFinished
    from vaoi_station.acquisition.ring import Ring
    from vaoi_station.config import read_config
    from vaoi_station.files import read_calibration
    from vaoi_station.files.directories import refuse_existing

    station = read_config(config)
    copies = {"calibration.json": station.calibration}
    if still and not station.calibration.exists():
        # The first calibration is made from such a recording, so no calibration can be required here.
        copies = {}
    else:
        read_calibration(station.calibration, [c.head for c in station.cameras])
    targets = [out] if runs == 1 else [out / f"run-{n:03d}" for n in range(1, runs + 1)]
    # All targets are checked before the first board: a board on the line cannot be filmed again.
    refuse_existing(*targets)
    kept: list[Path] = []

    def keep(finished: RunFinished, ring: Ring, generation: int) -> None:
        target = targets[len(kept)]
        export_run(target, finished, ring, generation, copies)
        kept.append(target)
        cameras, rows = len(station.cameras), finished.head.rows
        whole = cameras * rows - len(finished.head.missing)
        print(f"{target}: {rows} rows, {whole} of {cameras * rows} frames, ended by {finished.reason!r}")
        for frame in finished.frames:
            if frame.cause:
                print(f"  camera {frame.camera}, row {frame.row}: {frame.verdict}: {frame.cause}")

    def notice(sentence: str) -> None:
        # stderr, because stdout lists the recordings.
        print(sentence, file=sys.stderr)

    if still:
        film_pulses(station, runs, STILL_RATE_HZ, FilmingHandlers(keep, notice))
    else:
        film(station, runs, FilmingHandlers(keep, notice))


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


def doctor(
    config: ConfigOf = CONFIG,
    *,
    key_file: KeyFileOf = None,
    ca: CaOf = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    toggle_line_ready: Annotated[
        bool, typer.Option(help="Switch the output 'line ready' three times instead: stop the conveyor first.")
    ] = False,
) -> None:
    """Check machine, files and devices, and propose an action for each problem.

    Nothing is changed, except by --toggle-line-ready. Exit code: 0 without problems, 1 with warnings, 2 with faults.
    """
    if toggle_line_ready:
        from vaoi_station.config import read_config
        from vaoi_station.doctor.controller_checks import toggle_line_output

        toggle_line_output(read_config(config).controller, typer.echo)
        return
    from vaoi_station.doctor import run_checks
    from vaoi_station.doctor.finding import as_text

    report = run_checks(config, credentials=credentials_of(key_file, ca))
    typer.echo(json.dumps(report.document(), indent=1) if as_json else as_text(report), nl=as_json)
    raise typer.Exit(report.exit_code)


def bundle(
    config: ConfigOf = CONFIG,
    out: Annotated[Path, typer.Option(help="Write this file.")] = Path("vaoi-support.tar.gz"),
    key_file: KeyFileOf = None,
    ca: CaOf = None,
) -> None:
    """Write log, configuration, findings of the doctor and state of the station into one file, without secrets."""
    from vaoi_station.doctor.support_bundle import write_support_bundle

    made = write_support_bundle(config, out, credentials_of(key_file, ca))
    typer.echo(f"{out}: {len(made.members)} files, without pictures, layouts and secrets. Read it before you send it.")
    for name, cause in made.missing.items():
        typer.echo(f"{name}: {cause}", err=True)


def backup(
    file: Annotated[Path, typer.Argument(help="Write the backup to this file, which must not exist.")],
    config: ConfigOf = CONFIG,
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
    """Restore a backup where no station is. Nothing is written before the whole backup was checked.

    Prints the files that must be put back, and the keys of callers that are valid: those of the backup.
    """
    from vaoi_station.files.access_keys import KEY_FILE, KeyFile
    from vaoi_station.transfer.backup import absent_files
    from vaoi_station.transfer.backup import restore as restore_backup

    station = restore_backup(file, config)
    typer.echo(f"{config}: station {station.name!r} is restored; its data are in {station.data}")
    for key, path in absent_files(station):
        typer.echo(f"not in the backup, put it back: {path} ({key})")
    for entry in KeyFile(station.data / KEY_FILE).entries():
        typer.echo(
            f"valid key: {entry.name} ({', '.join(entry.scopes)}), made {entry.created}; if it was revoked since:"
            f" vaoi keys revoke {entry.name} --config {config}"
        )


def export(
    run: Annotated[str, typer.Argument(help="Id of the run.")],
    out: Annotated[Path, typer.Option(help="Write the run to this file, which must not exist.")],
    config: ConfigOf = CONFIG,
) -> None:
    """Write a run to one file: result, record, calibration, board type, and frames if they were kept."""
    from vaoi_station.transfer.runs import export_run

    recorded = export_run(config, run, out)
    typer.echo(f"{out}: run {run} {'with' if recorded else 'without'} frames")


def import_exported_run(file: Path, out: Path | None, config: Path | None) -> None:
    """Unpack an exported run into a directory, or put it into the history of a station."""
    from vaoi_station.errors import InputError
    from vaoi_station.transfer.runs import import_into_history, import_run

    if (out is None) == (config is None):
        raise InputError("import needs either --out or --config.", action="Give exactly one of them.")
    if config is not None:
        imported = import_into_history(file, config)
        frames = "with frames" if imported.with_frames else "without frames"
        origin = imported.detail.origin
        good = ", a good board" if imported.good else ""
        station = origin.station if origin else ""
        typer.echo(f"{config}: run {imported.detail.id} of {station!r}, {frames}, pinned{good}")
        return
    assert out is not None, "one of the two is given"
    detail = import_run(file, out)
    typer.echo(f"{out}: run {detail.id} of board type {detail.board_type!r}, {detail.verdict}")


_SIDES = ("top", "bottom")


def import_file(
    file: Annotated[Path, typer.Argument(help="An exported run, or board data (a file, or an ODB++ folder).")],
    out: Annotated[
        Path | None,
        typer.Option(help="Write the run to this directory, or the board type to this file; must not exist."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Run: put it into the history of the station of this station.toml.")
    ] = None,
    side: Annotated[str, typer.Option(help="Board data: the side that is up in the line, top or bottom.")] = "top",
    format: Annotated[
        str | None,
        typer.Option(
            help="Board data: kicad, gencad, ipc2581, odb, eagle, html-bom or centroid; by default recognised."
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Board data: name of the board type; by default the design's.")
    ] = None,
    units: Annotated[str | None, typer.Option(help="Centroid file: mm, inch or mil; by default recognised.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help="Centroid file: columns by number or header, as ref=1,x=3,y=4,rotation=5,side=Layer,fitted=DNP; "
            "side=bottom states the side of all parts, rotation=none that there is none."
        ),
    ] = None,
    delimiter: Annotated[str | None, typer.Option(help="Centroid file: one character; by default recognised.")] = None,
    step: Annotated[
        str | None,
        typer.Option(help="ODB++, IPC-2581: the step, a board or a panel; by default the board with most components."),
    ] = None,
    repeat: Annotated[
        str | None, typer.Option(help="Panel of a file of one board: number of boards along x and y, as 3x2.")
    ] = None,
    pitch: Annotated[str | None, typer.Option(help="Panel: distance from board to board, mm, as 30x28.5.")] = None,
    rotate: Annotated[
        str | None, typer.Option(help="Panel: rotations of the boards in turn, degrees, as 0,180 [all 0].")
    ] = None,
    border: Annotated[
        str | None, typer.Option(help="Panel: from the outermost boards to its edges, mm, as 0x5 [no outline].")
    ] = None,
    join: Annotated[
        Path | None,
        typer.Option(
            help="Centroid file: take bodies, heights, outline and marks from this file, by designator. "
            "An IPC-D-356 netlist: test points."
        ),
    ] = None,
    sizes: Annotated[Path | None, typer.Option(help="TOML table of body sizes by package name.")] = None,
    test_points: Annotated[
        bool, typer.Option(help="Board data: keep pads and vias that a probe reaches as test points.")
    ] = True,
) -> None:
    """Import an exported run, or make a board type (board.json) of the board data of a CAD system.

    Board data: KiCad, GenCAD, IPC-2581, ODB++, EAGLE, InteractiveHtmlBom, centroid files of any program.
    """
    from vaoi_station.board_data import is_exported_run
    from vaoi_station.errors import InputError

    if config is not None or (format is None and is_exported_run(file)):
        import_exported_run(file, out, config)
        return
    if side not in _SIDES:
        raise InputError.field("--side", "the side", side, "top or bottom")
    if out is None:
        raise InputError("a board type needs a file to be written to.", action="Give it by --out board.json.")
    task = {"file": file, "side": side, "name": name, "format": format, "units": units, "columns": columns}
    task |= {"delimiter": delimiter, "step": step, "repeat": repeat, "pitch": pitch, "rotate": rotate}
    _import_board_data(out, task | {"border": border, "sizes": sizes, "join": join, "test_points": test_points})


def _import_board_data(out: Path, task: dict[str, object]) -> None:
    from vaoi_station.board_data.import_process import OF_PERSONS, ImportTask, import_limited
    from vaoi_station.files.board_types import write_board_type
    from vaoi_station.files.directories import refuse_existing
    from vaoi_station.model import BoardType

    refuse_existing(out)
    reply = import_limited(ImportTask.model_validate(task), OF_PERSONS)
    found = reply.overview
    assert found is not None
    write_board_type(out, BoardType.model_validate_json(reply.board_type))
    shown = ", ".join(f"{count} sizes from {_SIZE_WORDS[key]}" for key, count in found.sizes_from.items())
    typer.echo(
        f"{out}: {found.side} of {found.name!r} ({found.format}): {found.components} components, {shown}; "
        f"{found.fiducials} fiducials; {found.test_points} test points"
    )
    for remark in found.check:
        typer.echo(f"check: {remark.message}")


_SIZE_WORDS = {"file": "the file", "table": "the table of packages", "guess": "a guess"}

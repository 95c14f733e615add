"""`vaoi import`: an exported run, or the board data of a CAD system."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
        typer.Option(help="Centroid file: take bodies, heights, outline and marks from this file, by designator."),
    ] = None,
    sizes: Annotated[Path | None, typer.Option(help="TOML table of body sizes by package name.")] = None,
) -> None:
    """Import an exported run, or make a board type (board.json) of the board data of a CAD system.

    Board data: KiCad, GenCAD, IPC-2581, ODB++, EAGLE, InteractiveHtmlBom, centroid files of any program.
    """
    from vaoi_station.board_data import is_exported_run
    from vaoi_station.cli.station.export import import_exported_run
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
    _import_board_data(out, task | {"border": border, "sizes": sizes, "join": join})


def _import_board_data(out: Path, task: dict[str, object]) -> None:
    """Write a board type, and print what was recognised and what to check."""
    from vaoi_station.board_data.import_process import OF_PERSONS, ImportTask
    from vaoi_station.board_data.limited_import import import_limited
    from vaoi_station.files.atomic_directory import refuse_existing
    from vaoi_station.files.board_types import write_board_type
    from vaoi_station.model import BoardType

    refuse_existing(out)
    reply = import_limited(ImportTask.model_validate(task), OF_PERSONS)
    found = reply.overview
    assert found is not None
    write_board_type(out, BoardType.model_validate_json(reply.board_type))
    shown = ", ".join(f"{count} sizes from {_SIZE_WORDS[key]}" for key, count in found.sizes_from.items())
    typer.echo(
        f"{out}: {found.side} of {found.name!r} ({found.format}): {found.components} components, {shown}; "
        f"{found.fiducials} fiducials"
    )
    for remark in found.check:
        typer.echo(f"check: {remark.message}")


_SIZE_WORDS = {"file": "the file", "table": "the table of packages", "guess": "a guess"}

"""`vaoi import`: an exported run, or the board data of a CAD system."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

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
            "side=bottom states the side of all parts."
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
    from vaoi_station.board_data import Grid, Options, is_exported_run
    from vaoi_station.board_data.readers.placement_table import TableOptions
    from vaoi_station.cli.station.export import import_exported_run
    from vaoi_station.errors import InputError

    if config is not None or (format is None and is_exported_run(file)):
        import_exported_run(file, out, config)
        return
    if side not in _SIDES:
        raise InputError.field("--side", "the side", side, "top or bottom")
    if out is None:
        raise InputError("a board type needs a file to be written to.", action="Give it by --out board.json.")
    table = TableOptions.parse(units, columns, delimiter)
    grid = Grid.parse(repeat, pitch, rotate, border)
    _import_board_data(file, join, Options(format, table, step, sizes, grid), side, out, name)


def _import_board_data(file: Path, join: Path | None, options: object, side: str, out: Path, name: str | None) -> None:
    """Write a board type, and print what was recognised and what to check."""
    from collections import Counter

    from vaoi_station.board_data import Options, read_design, to_board_type
    from vaoi_station.files.atomic_directory import refuse_existing
    from vaoi_station.files.board_types import write_board_type

    assert isinstance(options, Options)
    refuse_existing(out)
    up: Literal["top", "bottom"] = "bottom" if side == "bottom" else "top"
    design = read_design(file, options, join, up)
    board, notes = to_board_type(design, up, name)
    write_board_type(out, board)
    sizes = Counter(c.size_from for c in board.components)
    shown = ", ".join(f"{count} sizes from {_SIZE_WORDS[key]}" for key, count in sizes.items() if key)
    typer.echo(
        f"{out}: {side} of {board.name!r} ({design.format}): {len(board.components)} components, {shown}; "
        f"{len(board.fiducials)} fiducials"
    )
    for note in notes:
        typer.echo(f"check: {note}")


_SIZE_WORDS = {"file": "the file", "table": "the table of packages", "guess": "a guess"}

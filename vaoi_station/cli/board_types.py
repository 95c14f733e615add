"""`vaoi board-types`: list the board types of a running station, and restore one that was replaced or deleted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer

from vaoi_station.cli.options import STATION, CaOf, KeyFileOf, StationOf, client_of

board_types = typer.Typer(help="The board types of a running station, and earlier versions.", no_args_is_help=True)

NAME = Annotated[str, typer.Argument(help="Name of the board type.")]


@board_types.command("list")
def list_board_types(station: StationOf = STATION, key_file: KeyFileOf = None, ca: CaOf = None) -> None:
    """List the board types, and those that were deleted and can be restored."""
    reply = client_of(station, key_file, ca).get("/board-types")
    for entry in reply["board_types"]:
        typer.echo(f"{entry['name']:40} {entry['components']:6} components  {entry['state']}")
    for name in reply["deleted"]:
        typer.echo(f"{name:40} deleted")


@board_types.command()
def revisions(name: NAME, station: StationOf = STATION, key_file: KeyFileOf = None, ca: CaOf = None) -> None:
    """List the versions of a board type that were replaced or deleted, newest first."""
    for entry in client_of(station, key_file, ca).get(f"/board-types/{quote(name, safe='')}/revisions")["revisions"]:
        typer.echo(f"{entry['id']}  in force from {entry['stored']} to {entry['ended']}  {entry['size_bytes']} bytes")


@board_types.command()
def restore(
    name: NAME,
    revision: Annotated[
        str, typer.Argument(help="Id of the version, as `revisions` lists it; by default the one before the present.")
    ] = "latest",
    station: StationOf = STATION,
    key_file: KeyFileOf = None,
    ca: CaOf = None,
) -> None:
    """Put a version in force again, from the next arming on. The present one becomes a version itself."""
    path = f"/board-types/{quote(name, safe='')}/revisions/{quote(revision, safe='')}/restore"
    reply = client_of(station, key_file, ca).post(path)
    typer.echo(f"{name}: version {revision} is in force, {len(reply['components'])} components.")


@board_types.command()
def state(
    name: NAME,
    state: Annotated[str, typer.Argument(help="draft (armed with a warning), approved, or retired (not armed).")],
    revision: Annotated[str | None, typer.Option(help="Revision of the data; by default it stays.")] = None,
    station: StationOf = STATION,
    key_file: KeyFileOf = None,
    ca: CaOf = None,
) -> None:
    """Set the state of a board type, from the next arming on."""
    document = {"state": state} | ({} if revision is None else {"revision": revision})
    reply = client_of(station, key_file, ca).act("PUT", f"/board-types/{quote(name, safe='')}/state", document)
    typer.echo(f"{name}: {reply['state']}, revision {reply.get('revision', 'not stated')}.")


@board_types.command("import")
def import_board_data(
    file: Annotated[Path, typer.Argument(help="A file of a CAD system or placement machine.")],
    side: Annotated[str, typer.Option(help="The side that is up in the line, top or bottom.")] = "top",
    name: Annotated[str | None, typer.Option(help="Name of the board type; by default the design's.")] = None,
    format: Annotated[str | None, typer.Option(help="Format of the file, as of `vaoi import`.")] = None,
    units: Annotated[str | None, typer.Option(help="Centroid file: mm, inch or mil.")] = None,
    columns: Annotated[str | None, typer.Option(help="Centroid file: columns, as of `vaoi import`.")] = None,
    delimiter: Annotated[str | None, typer.Option(help="Centroid file: one character.")] = None,
    step: Annotated[str | None, typer.Option(help="ODB++, IPC-2581: the step, a board or a panel.")] = None,
    join: Annotated[
        Path | None,
        typer.Option(help="Take bodies, outline and marks from this file, or test points from this netlist."),
    ] = None,
    sizes: Annotated[Path | None, typer.Option(help="TOML table of body sizes by package name.")] = None,
    test_points: Annotated[bool, typer.Option(help="Keep pads and vias that a probe reaches as test points.")] = True,
    confirm: Annotated[bool, typer.Option("--confirm", help="Store the board type; else only show it.")] = False,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace a board type of the same name; its version is kept.")
    ] = False,
    station: StationOf = STATION,
    key_file: KeyFileOf = None,
    ca: CaOf = None,
) -> None:
    """Make a board type of board data on a running station."""
    from vaoi_station.errors import InputError, StateError, VaoiError
    from vaoi_station.library.live_station import StationImport

    client = client_of(station, key_file, ca)
    options: dict[str, object] = {"side": side, "name": name, "format": format, "units": units, "columns": columns}
    options |= {"delimiter": delimiter, "step": step, "sizes": sizes}
    options |= {} if test_points else {"test_points": False}
    bodies = None if join is None else StationImport.upload(client, join, {})
    if bodies is not None:
        options["join"] = bodies.document["id"]
    preview = StationImport.upload(client, file, options)
    found = preview.document.get("found")
    if found is None:
        raise InputError(preview.document["refusal"])
    typer.echo(
        f"{found['side']} of {found['name']!r} ({found['format']}): {found['components']} components, "
        f"{found['fiducials']} fiducials, {found['test_points']} test points"
    )
    for remark in found["check"]:
        typer.echo(f"check: {remark['message']}")
    if confirm:
        try:
            stored = preview.confirm(new=not replace)
        except VaoiError as error:
            if error.code != "changed":
                raise
            raise StateError(
                f"There is a board type {found['name']!r}; nothing was stored.",
                action="Give another --name, or --replace.",
                code="changed",
            ) from error
        if bodies is not None:
            bodies.discard()
        typer.echo(f"{stored.name}: stored; it can be armed.")
    else:
        typer.echo(f"picture: {station.rstrip('/')}{preview.document['picture']}")
        typer.echo("Nothing is stored yet: repeat with --confirm.")

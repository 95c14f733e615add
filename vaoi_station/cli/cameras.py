"""`vaoi cameras`: cameras of the network and their addresses; the exchange of a camera of a running station."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from vaoi_station.cli.options import STATION, CaOf, KeyFileOf, StationOf, client_of
from vaoi_station.errors import NotFoundError

if TYPE_CHECKING:
    from vaoi_station.demo.client import Client

cameras = typer.Typer(
    help="Cameras that answer on this computer's network, and the exchange of one.", no_args_is_help=True
)

SERIAL = Annotated[str, typer.Argument(help="Serial number of the camera, as on its label.")]
PLACE = Annotated[str, typer.Argument(help="Name of the place in station.toml, or its number from 0.")]


@cameras.command("list")
def list_cameras() -> None:
    """List the cameras that answer, also those of a foreign network and at USB3. No station is needed."""
    from vaoi_station.acquisition.cameras.aravis.discovery import search_all
    from vaoi_station.acquisition.cameras.aravis.network import Control

    words = {
        Control.ABSENT: "not reachable: its address is of another network (vaoi cameras set-address)",
        Control.FREE: "free",
        Control.CONTROLLED: "in use",
    }
    found = search_all()
    for camera in found:
        what = f"{camera.maker} {camera.model}"
        typer.echo(f"{camera.serial:16} {what:32} {camera.address:15} {camera.interface:8} {words[camera.control]}")
    if not found:
        typer.echo("No camera answers on a network port of this computer, or is at USB3.", err=True)


@cameras.command("set-address")
def set_camera_address(
    serial: SERIAL,
    address: Annotated[str | None, typer.Argument(help="IPv4 address [a free one in the network of its port].")] = None,
) -> None:
    """Give a camera that no program uses an address, now and after every power-on. No station is needed."""
    from vaoi_station.acquisition.cameras.aravis.discovery import discover, find, free_address, set_address

    found = discover()
    camera = find(serial, found)
    address = address or free_address(camera, (), {other.address for other in found})
    set_address(camera, address)
    typer.echo(f"{serial}: {address} in place of {camera.address}, kept for every power-on.")


@cameras.command()
def replace(
    place: PLACE,
    serial: SERIAL,
    *,
    address: Annotated[str | None, typer.Option(help="Give it this address [kept, or a free one if needed].")] = None,
    station: StationOf = STATION,
    key_file: KeyFileOf = None,
    ca: CaOf = None,
) -> None:
    """Put a camera of the same model in the place of one that is gone, while the station runs (scope admin)."""
    client = client_of(station, key_file, ca)
    number = _number(client, place)
    fields = {"serial": serial} if address is None else {"serial": serial, "address": address}
    made = client.post(f"/cameras/{number}/exchange", **fields)
    typer.echo(f"{made['name']}: {made['serial']} at {made['address']} is in the place of {made['before']}.")
    typer.echo(f"Let a board pass; then: vaoi cameras confirm {place}")


@cameras.command()
def confirm(place: PLACE, station: StationOf = STATION, key_file: KeyFileOf = None, ca: CaOf = None) -> None:
    """Put the calibration of an exchanged camera in force, as the boards since then show it (scope admin)."""
    client = client_of(station, key_file, ca)
    made = client.post(f"/cameras/{_number(client, place)}/exchange/confirm")
    for line in made["lines"]:
        typer.echo(line)
    typer.echo(f"in force, known to {made['sigma_px']} px; the calibration before is {made.get('backup')}")


def _number(client: Client, place: str) -> int:
    """Return the number of a place by its name or number; raise NotFoundError if the station has no such place."""
    places: list[dict[str, Any]] = client.get("/station")["cameras"]
    for camera in places:
        if place in (camera["name"], str(camera["camera"])):
            return int(camera["camera"])
    names = ", ".join(camera["name"] for camera in places)
    raise NotFoundError(f"The station has no camera {place!r}.", action=f"Give one of: {names}.")

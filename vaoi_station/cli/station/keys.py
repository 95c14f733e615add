"""`vaoi keys`: make, list, rotate and revoke the keys of a station. A running station follows at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vaoi_station.files.access_keys import KeyFile

keys = typer.Typer(help="The keys with which programs and people use the REST service.", no_args_is_help=True)

CONFIG = Annotated[Path, typer.Option(help="The station.toml of the station.")]
NAME = Annotated[str, typer.Argument(help="Name of the key; the audit log shows it.")]
DEFAULT = Path("station.toml")


@keys.command()
def create(
    name: NAME,
    scope: Annotated[list[str], typer.Option(help="read, operate, teach or admin; repeat for several.")],
    config: CONFIG = DEFAULT,
) -> None:
    """Make a key and print it. It is printed only now: the station keeps its hash."""
    typer.echo(_file(config).create(name, scope).secret)


@keys.command("list")
def list_keys(config: CONFIG = DEFAULT) -> None:
    """List the keys, without their secrets."""
    for key in _file(config).entries():
        typer.echo(f"{key.name:24} {','.join(key.scopes):28} {key.created} {key.id}")


@keys.command()
def rotate(name: NAME, config: CONFIG = DEFAULT) -> None:
    """Replace a key by a new one, and print it. The old one is refused from now on."""
    typer.echo(_file(config).rotate(name).secret)


@keys.command()
def revoke(name: NAME, config: CONFIG = DEFAULT) -> None:
    """End a key: it is refused from now on."""
    _file(config).revoke(name)


def _file(config: Path) -> KeyFile:
    from vaoi_station.config import read_config
    from vaoi_station.files.access_keys import KEY_FILE, KeyFile

    return KeyFile(read_config(config).data / KEY_FILE)

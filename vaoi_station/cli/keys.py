"""`vaoi keys`: make, list, rotate and revoke the keys of a station. A running station follows at once."""

from __future__ import annotations

import getpass
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vaoi_station.cli.options import CONFIG, ConfigOf

if TYPE_CHECKING:
    from vaoi_station.files.access_keys import KeyFile

keys = typer.Typer(help="The keys with which programs and people use the REST service.", no_args_is_help=True)

NAME = Annotated[str, typer.Argument(help="Name of the key; the audit log shows it.")]


@keys.command()
def create(
    name: NAME,
    scope: Annotated[list[str], typer.Option(help="read, operate, teach or admin; repeat for several.")],
    config: ConfigOf = CONFIG,
) -> None:
    """Make a key and print it. It is printed only now: the station keeps its hash."""
    made = _file(config).create(name, scope)
    _note(config, f"keys create {name}", made.key.scopes)
    typer.echo(made.secret)


@keys.command("list")
def list_keys(config: ConfigOf = CONFIG) -> None:
    """List the keys, without their secrets."""
    found = _file(config).entries()
    if not found:
        typer.echo("There is no key: callers from outside are refused. Make one with vaoi keys create.", err=True)
    for key in found:
        typer.echo(f"{key.name:24} {','.join(key.scopes):28} {key.created} {key.id}")


@keys.command()
def rotate(name: NAME, config: ConfigOf = CONFIG) -> None:
    """Replace a key by a new one, and print it. The old one is refused from now on."""
    made = _file(config).rotate(name)
    _note(config, f"keys rotate {name}")
    typer.echo(made.secret)


@keys.command()
def revoke(name: NAME, config: ConfigOf = CONFIG) -> None:
    """End a key: it is refused from now on."""
    _file(config).revoke(name)
    _note(config, f"keys revoke {name}")
    typer.echo(f"Key {name!r} is revoked.")


def _note(config: Path, command: str, scopes: Sequence[str] = ()) -> None:
    from vaoi_station.config import read_config
    from vaoi_station.files.access_keys import AUDIT_FILE, note_change

    path = read_config(config).data / AUDIT_FILE
    # With sudo, the user who has become root.
    user = os.environ.get("SUDO_USER") or getpass.getuser()
    try:
        note_change(path, user, command, scopes)
    except OSError as error:
        # The key is changed already, and its secret is shown only now.
        typer.echo(f"{path}: cannot be written ({error.strerror}); the audit log lacks this command.", err=True)


def _file(config: Path) -> KeyFile:
    from vaoi_station.config import read_config
    from vaoi_station.files.access_keys import KEY_FILE, KeyFile

    return KeyFile(read_config(config).data / KEY_FILE)

"""station.toml over REST: read with its documentation, checked, and changed key by key."""

from __future__ import annotations

import difflib
import json
import logging
import threading
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from pydantic import BaseModel, Field

from vaoi_station.api.access import CHANGED
from vaoi_station.api.http_caching import require_unchanged, tag_of
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.station_files import (
    StationFiles,
    install_command,
    is_writable,
    replace_with_backup,
    restart_command,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files.documents import key_at, parse, parse_toml, text_of
from vaoi_station.model import Strict
from vaoi_station.settings.edits import MARK, Edit, edit_toml, hidden_edits, key_of, without_secrets
from vaoi_station.settings.edits import Path as Place
from vaoi_station.settings.faults import examine
from vaoi_station.settings.keys import Kind, Setting, keys

_log = logging.getLogger(__name__)

_MADE_BY_THE_STATION = frozenset({"data", "ring.directory"})
"""Directories that a start makes."""
Tag = Annotated[
    str, Header(alias="If-Match", description="ETag of what the caller has read; else 412.", max_length=500)
]


class SettingFault(BaseModel):
    """What is wrong in a station.toml."""

    key: str = Field(description="`cameras.1.width`; empty if several tables contradict each other.")
    message: str


class Settings(BaseModel):
    """station.toml as it is on disk. What may be secret is hidden: `…` stands in its place."""

    path: str
    text: str = Field(description="The file, with its comments.")
    values: dict[str, Any] = Field(description="What it says, by table and key.")
    keys: list[Setting] = Field(description="All keys that it may have.")
    faults: list[SettingFault]
    hidden: list[str] = Field(description="Keys of which a part is hidden. Entered anew, they are entered whole.")
    pending: list[str] = Field(description="Keys that were changed since the start of the station: a restart is due.")
    writable: bool = Field(description="Whether the service may write the file. Else an administrator puts it there.")
    install: str = Field(description="The command by which an administrator puts a file there.")
    restart: str = Field(description="The command that restarts the service. Everything in the file needs it.")


class SettingChange(Strict):
    """A value that shall stand in station.toml from now on."""

    key: str = Field(
        description="`line.tail_s`, `cameras.0.width`; the index after the last one appends a table.",
        pattern=r"^[^.\x00-\x1f]+(\.[^.\x00-\x1f]+)*$",
        max_length=300,
    )
    value: Any = Field(default=None, description="Absent or null removes the key, the table or the array's element.")


class SettingsChange(Strict):
    """Changes of station.toml. They are made together or not at all."""

    changes: list[SettingChange] = Field(min_length=1, max_length=500, description="New values by key.")


class SettingsProposal(BaseModel):
    """What station.toml would be after the changes. Secrets are hidden as in `Settings`."""

    faults: list[SettingFault] = Field(description="All of them; with any, nothing can be saved.")
    notes: list[SettingFault] = Field(description="What may be a mistake: files that the service does not find.")
    changed: list[str] = Field(description="Keys with another value.")
    diff: str = Field(description="The lines that change, as a unified diff.")
    text: str = Field(description="The new file.")
    hidden: int = Field(description="Number of hidden values in it, which must be entered before it can be used.")


class SettingsSaved(BaseModel):
    """station.toml was written. It is in force from the next start of the station on."""

    path: str
    backup: str | None = Field(default=None, description="Name of the copy of the file before.")
    changed: list[str]
    restart: str


def router(services: Services, files: StationFiles) -> APIRouter:
    """Create the routes under `settings`. All of them need the scope admin."""
    routes, ask = rest_router(prefix="/settings", tags=["setup"]), services.commands.ask
    file = SettingsFile(files)

    @routes.get("")
    async def get_settings(response: Response) -> Settings:
        """Return station.toml as it is on disk, and all keys that it may have, with units, limits and documentation.

        The ETag of the reply is the condition of a change.
        """
        content = await ask(file.content)
        response.headers["ETag"] = tag_of(content)
        return await ask(file.read, content)

    @routes.post("/check")
    async def check_settings(wanted: SettingsChange) -> SettingsProposal:
        """Return what station.toml would be after changes: all its faults at once, and the lines that change.

        Nothing is written. Devices are not opened; `vaoi check-config` examines the files that it names as well.
        """
        return await ask(lambda: file.propose(wanted.changes, file.content()))

    @routes.put("")
    async def change_settings(request: Request, wanted: SettingsChange, _: Tag) -> SettingsSaved:
        """Change station.toml, of which a copy is kept; in force from the next start of the station on.

        Comments and order of the file stay. 412 `changed`: the file has changed since the caller read it; 409
        `settings-read-only`: the service may not write it.
        """
        name = files.path.name
        saved = await ask(file.save, wanted.changes, lambda content: require_unchanged(request, content, name))
        # The audit log has the names of what was changed, and no values.
        request.scope["state"][CHANGED] = saved.changed
        return saved

    return routes


class SettingsFile:
    """The station.toml of a station. Methods may be called from any thread; changes are made one after the other."""

    def __init__(self, files: StationFiles) -> None:
        self._files, self._path = files, files.path
        self._saving = threading.Lock()

    def content(self) -> bytes:
        """Return the bytes of the file; raise InputError if it cannot be read."""
        try:
            return self._path.read_bytes()
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror}).") from error

    def read(self, content: bytes) -> Settings:
        """Return what the file says; raise InputError if it is no TOML."""
        text, data = self._parsed(content)
        faults, shown = _faults(data), without_secrets(text, data)
        base, pending = self._path.parent, list[str]()
        if not faults:
            on_disk = parse(StationConfig, data, self._path)
            pending = _different(_plain(self._files.config, base), _plain(on_disk, base))
        return Settings(
            path=str(self._path),
            text=shown,
            values=json.loads(json.dumps(tomllib.loads(shown), default=str)),
            keys=list(keys()),
            faults=faults,
            hidden=[key_of(edit.path) for edit in hidden_edits(data)],
            pending=pending,
            writable=is_writable(self._path),
            install=install_command(self._path),
            restart=restart_command(self._path),
        )

    def propose(self, changes: Sequence[SettingChange], content: bytes) -> SettingsProposal:
        """Return the file after the changes, with all its faults; nothing is written."""
        text, data = self._parsed(content)
        new, refused = _changed(text, data, changes)
        new_data = tomllib.loads(new)
        before, after = without_secrets(text, data), without_secrets(new, new_data)
        name, changed, flat = self._path.name, _different(data, new_data), dict(_flat(new_data))
        absent = [
            SettingFault(key=key, message=f"{flat[key]}: there is no such file for the service")
            for key in changed
            if key not in _MADE_BY_THE_STATION
            and _kind_of(key.split(".")) == "path"
            and isinstance(flat.get(key), str)
            and not (self._path.parent / flat[key]).exists()
        ]
        return SettingsProposal(
            faults=refused + _faults(new_data),
            notes=absent,
            changed=changed,
            diff="\n".join(difflib.unified_diff(before.splitlines(), after.splitlines(), name, name, lineterm="")),
            text=after,
            hidden=len(list(hidden_edits(new_data))),
        )

    def save(self, changes: Sequence[SettingChange], require: Callable[[bytes], None]) -> SettingsSaved:
        """Write the file after the changes, and keep a copy of the one before.

        `require` is called with the present content, and raises an error if the caller has read another one.

        Raises:
            InputError: the file would have faults, or cannot be written to.
            StateError: the service may not write the file.
        """
        with self._saving:
            content = self.content()
            require(content)
            text, data = self._parsed(content)
            new, refused = _changed(text, data, changes)
            if refused:
                raise InputError("; ".join(f"{f.key}: {f.message}" for f in refused[:5]) + ".", code="not-editable")
            new_data = tomllib.loads(new)
            parse(StationConfig, new_data, self._path)
            backup = replace_with_backup(self._path, new.encode())
        changed = _different(data, new_data)
        _log.info("%s was changed: %s", self._path, ", ".join(changed))
        return SettingsSaved(path=str(self._path), backup=backup, changed=changed, restart=restart_command(self._path))

    def _parsed(self, content: bytes) -> tuple[str, dict[str, Any]]:
        text = text_of(content, self._path)
        return text, parse_toml(text, self._path)


BY_HAND = frozenset({"camera_power"})
"""Tables that callers of REST may not change: with them, they could run any program."""


def _faults(data: dict[str, Any]) -> list[SettingFault]:
    return [SettingFault(key=key_at(f.place) if f.place else "", message=f.text) for f in examine(data)[0]]


def _changed(text: str, data: dict[str, Any], changes: Sequence[SettingChange]) -> tuple[str, list[SettingFault]]:
    """Return the text after all changes that can be made, and a fault for each of the others."""
    edits, refused = list[Edit](), list[SettingFault]()
    for change in changes:
        path, value = _place(data, change.key), change.value
        if isinstance(value, str) and MARK in value:
            refused.append(SettingFault(key=change.key, message="holds the mark of a hidden value; enter it whole"))
            continue
        if path and path[0] in BY_HAND:
            message = "names a command that the station runs; change it in the file on the station"
            refused.append(SettingFault(key=change.key, message=message))
            continue
        # JSON has one kind of number: 5 of a key with decimals is written as 5.0.
        if type(value) is int and _kind_of(path) == "number" and abs(value) < 1 << 53:
            value = float(value)
        edits.append(Edit(path, value))
    try:
        return edit_toml(text, edits), refused
    except InputError as error:
        return text, [*refused, SettingFault(key=error.message.split(":")[0], message=str(error))]


def _place(data: Any, key: str) -> Place:
    """Return a key as a path: a number is an index unless it names a key of a table."""
    path: list[str | int] = []
    for part in key.split("."):
        step = int(part) if part.isdigit() and not isinstance(data, dict) and len(part) < 6 else part
        path.append(step)
        if isinstance(data, dict):
            data = data.get(part)
        else:
            data = data[step] if isinstance(data, list) and isinstance(step, int) and step < len(data) else None
    return tuple(path)


def _kind_of(path: Sequence[str | int]) -> Kind | None:
    """Return the kind of the key at a path; None if no model has it."""
    for key in keys():
        steps = key.key.replace("[]", ".[]").split(".")
        if len(steps) == len(path) and all(
            known in (str(step), "NAME") or (known == "[]" and str(step).isdigit())
            for known, step in zip(steps, path, strict=True)
        ):
            return key.kind
    return None


def _different(one: Any, other: Any) -> list[str]:
    first, second = dict(_flat(one)), dict(_flat(other))
    return [key for key in dict.fromkeys((*first, *second)) if first.get(key) != second.get(key)]


def _flat(data: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield all values of tables and arrays of tables, by their keys."""
    tables = isinstance(data, list | tuple) and data and all(isinstance(v, dict) for v in data)
    if isinstance(data, dict) or tables:
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _flat(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, list(data) if isinstance(data, tuple) else data


def _plain(config: StationConfig, base: Path) -> Any:
    """Return a configuration as JSON; paths begin at the folder of station.toml, as the station has them."""

    def absolute(value: Any) -> Any:
        match value:
            case Path():
                return str(base / value)
            case dict():
                return {key: absolute(v) for key, v in value.items()}
            case list() | tuple():
                return [absolute(v) for v in value]
        return value

    return absolute(config.model_dump())

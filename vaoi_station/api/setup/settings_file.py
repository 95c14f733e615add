"""station.toml as a document that is read, changed key by key, checked, and written."""

from __future__ import annotations

import difflib
import json
import logging
import threading
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from vaoi_station.api.setup.settings_models import (
    Setting,
    SettingChange,
    SettingFault,
    Settings,
    SettingsProposal,
    SettingsSaved,
)
from vaoi_station.api.setup.station_files import (
    StationFiles,
    install_command,
    is_writable,
    replace_with_backup,
    restart_command,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files.documents import key_at, parse, parse_toml
from vaoi_station.files.text_files import text_of
from vaoi_station.settings.edits import Edit, edit_toml, key_of, toml_value
from vaoi_station.settings.faults import examine
from vaoi_station.settings.hidden import MARK, hidden_edits, without_secrets
from vaoi_station.settings.keys import Key, keys
from vaoi_station.settings.statements import Path as Place

_log = logging.getLogger(__name__)

_MADE_BY_THE_STATION = frozenset({"data", "ring.directory"})
"""Directories that a start makes."""


class SettingsFile:
    """The station.toml of a station. Methods may be called from any thread; changes are made one after the other."""

    def __init__(self, files: StationFiles) -> None:
        self._files = files
        self._saving = threading.Lock()

    def content(self) -> bytes:
        """Return the bytes of the file; raise InputError if it cannot be read."""
        try:
            return self._files.path.read_bytes()
        except OSError as error:
            raise InputError(f"{self._files.path}: cannot be read ({error.strerror}).") from error

    def read(self, content: bytes) -> Settings:
        """Return what the file says; raise InputError if it is no TOML."""
        text, data = self._parsed(content)
        faults, _ = examine(data)
        shown = without_secrets(text, data)
        path = self._files.path
        return Settings(
            path=str(path),
            text=shown,
            values=json.loads(json.dumps(tomllib.loads(shown), default=str)),
            keys=[_setting(key) for key in keys()],
            faults=[SettingFault(key=key_at(f.place) if f.place else "", message=f.text) for f in faults],
            hidden=[key_of(edit.path) for edit in hidden_edits(data)],
            pending=self._pending(data) if not faults else [],
            writable=is_writable(path),
            install=install_command(path),
            restart=restart_command(path),
        )

    def propose(self, changes: Sequence[SettingChange], content: bytes) -> SettingsProposal:
        """Return the file after the changes, with all its faults; nothing is written."""
        text, data = self._parsed(content)
        new, faults = _changed(text, data, changes)
        found = tomllib.loads(new)
        faults += [SettingFault(key=key_at(f.place) if f.place else "", message=f.text) for f in examine(found)[0]]
        before, after = without_secrets(text, data), without_secrets(new, found)
        name = self._files.path.name
        lines = difflib.unified_diff(before.splitlines(), after.splitlines(), name, name, lineterm="")
        changed = _different(data, found)
        return SettingsProposal(
            faults=faults,
            notes=list(self._absent(found, changed)),
            changed=changed,
            diff="\n".join(lines),
            text=after,
            hidden=len(list(hidden_edits(found))),
        )

    def save(self, changes: Sequence[SettingChange], require: Callable[[bytes], None]) -> SettingsSaved:
        """Write the file after the changes, and keep a copy of the one before.

        Args:
            changes: what changes.
            require: called with the present content; raises an error if the caller has read another one.

        Raises:
            InputError: the file would have faults, or cannot be written to.
            StateError: the service may not write the file.
        """
        with self._saving:
            content = self.content()
            require(content)
            text, data = self._parsed(content)
            new, faults = _changed(text, data, changes)
            if faults:
                raise InputError("; ".join(f"{f.key}: {f.message}" for f in faults[:5]) + ".", code="not-editable")
            found = tomllib.loads(new)
            parse(StationConfig, found, self._files.path)
            backup = replace_with_backup(self._files.path, new.encode())
        changed = _different(data, found)
        _log.info("%s was changed: %s", self._files.path, ", ".join(changed))
        path = self._files.path
        return SettingsSaved(path=str(path), backup=backup, changed=changed, restart=restart_command(path))

    def _parsed(self, content: bytes) -> tuple[str, dict[str, Any]]:
        text = text_of(content, self._files.path)
        return text, parse_toml(text, self._files.path)

    def _pending(self, data: dict[str, Any]) -> list[str]:
        """Return the keys whose values on disk are not those with which the station was started."""
        on_disk = parse(StationConfig, data, self._files.path)
        base = self._files.path.parent
        return _different(_plain(self._files.config, base), _plain(on_disk, base))

    def _absent(self, data: dict[str, Any], changed: Sequence[str]) -> Iterator[SettingFault]:
        """Yield the changed paths that do not exist, as the service sees them."""
        paths = {key.key for key in keys() if key.kind == "path"} - _MADE_BY_THE_STATION
        flat = dict(_flat(data))
        for key in changed:
            value = flat.get(key)
            pattern = ".".join("[]" if part.isdigit() else part for part in key.split(".")).replace(".[]", "[]")
            if pattern in paths and isinstance(value, str) and not (self._files.path.parent / value).exists():
                yield SettingFault(key=key, message=f"{value}: there is no such file for the service")


def _changed(text: str, data: dict[str, Any], changes: Sequence[SettingChange]) -> tuple[str, list[SettingFault]]:
    """Return the text after all changes that can be made, and a fault for each of the others."""
    edits, faults = list[Edit](), list[SettingFault]()
    for change in changes:
        path = _place(data, change.key)
        if isinstance(change.value, str) and MARK in change.value:
            faults.append(SettingFault(key=change.key, message="holds the mark of a hidden value; enter it whole"))
        else:
            edits.append(Edit(path, _typed(path, change.value)))
    try:
        return edit_toml(text, edits), faults
    except InputError as error:
        return text, [*faults, SettingFault(key=error.message.split(":")[0], message=str(error))]


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


def _typed(path: Place, value: Any) -> Any:
    """Return a number of JSON as the file writes it: 5 of a key with decimals is 5.0."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return float(value) if whole and _kind_of(path) == "number" and abs(value) < 1 << 53 else value


def _kind_of(path: Place) -> str:
    pattern = "".join("[]" if isinstance(step, int) else f".{step}" for step in path)[1:]
    return next((key.kind for key in keys() if key.key == pattern or _fits(key.key, pattern)), "")


def _fits(key: str, pattern: str) -> bool:
    before, named, after = key.partition("NAME")
    return bool(named) and pattern.startswith(before) and pattern.endswith(after)


def _setting(key: Key) -> Setting:
    return Setting(
        key=key.key,
        table=key.table,
        kind=key.kind,
        required=key.required,
        default=None if key.default is None or key.required else toml_value(key.default),
        unit=key.unit or None,
        choices=list(key.choices),
        description=key.description,
        optional_table=key.optional_table,
        **key.limits,
    )


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

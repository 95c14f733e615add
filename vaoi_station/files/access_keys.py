"""The keys of callers, in the file `keys.json` of the station's data directory.

The file holds the hash of each key, never the key. `vaoi keys` and the REST service change it under a lock, and the
service reads it again when it has changed, so no restart is needed.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import secrets
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.files.documents import check_format, parse, read_json, write_json

Scope = Literal["read", "operate", "teach", "admin"]
KEY_FILE, AUDIT_FILE = "keys.json", "audit.jsonl"
FORMAT, VERSION = "vaoi-keys", 1
MOST_KEYS = 200
_PREFIX = "vaoi"
KeyName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]


class AccessKey(BaseModel):
    """One key: its name, what it permits, and its hash."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: KeyName
    id: Annotated[str, Field(pattern=r"^[0-9a-f]{12}$")]
    """Part of the key by which it is found in the file; it is not secret."""
    scopes: tuple[Scope, ...]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    created: str


class _KeyFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    format: str = FORMAT
    version: int = VERSION
    keys: tuple[AccessKey, ...] = ()


class NewKey(NamedTuple):
    """A key that was just made, with its secret, which cannot be read again."""

    key: AccessKey
    secret: str


class KeyFile:
    """The keys in one file. Methods may be called from any thread, and by several processes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._state: tuple[int, ...] | None = None
        self._keys: tuple[AccessKey, ...] = ()

    def entries(self) -> tuple[AccessKey, ...]:
        """Return all keys, sorted by name. The file is read only if it has changed; `VaoiError`: it cannot be used."""
        with self._lock:
            try:
                status = self.path.stat()
            except FileNotFoundError:
                self._state, self._keys = None, ()
                return ()
            except OSError as error:
                raise DeviceError(
                    f"{self.path}: cannot be read ({error.strerror}).",
                    action="Check disk, mount and permissions of the data directory.",
                ) from error
            state = (status.st_mtime_ns, status.st_size, status.st_ino)
            if state != self._state:
                data = read_json(self.path)
                check_format(data, self.path, FORMAT, VERSION)
                self._keys, self._state = parse(_KeyFile, data, self.path).keys, state
            return self._keys

    def find(self, secret: str) -> AccessKey | None:
        """Return the key with this secret; None if there is none."""
        prefix, _, rest = secret.partition("_")
        if prefix != _PREFIX or len(secret) > 200 or not secret.isascii():
            return None
        found = next((k for k in self.entries() if k.id == rest.partition("_")[0]), None)
        return found if found is not None and secrets.compare_digest(found.sha256, _hash(secret)) else None

    def create(self, name: str, scopes: Sequence[str]) -> NewKey:
        """Make a key. `InputError`: the name or a scope is invalid; `StateError`: the name is in use."""
        unknown = sorted(set(scopes) - set(Scope.__args__))  # type: ignore[attr-defined]
        if unknown or not scopes:
            raise InputError.field("keys", "scopes", list(scopes), "some of read, operate, teach, admin")
        with self._changing() as keys:
            if name in keys:
                raise StateError(f"There is a key {name!r} already.", action="Rotate it, or choose another name.")
            if len(keys) >= MOST_KEYS:
                raise StateError(f"There are {len(keys)} keys, which is the limit.", action="Revoke unused keys.")
            made = _new(name, scopes)
            keys[name] = made.key
        return made

    def rotate(self, name: str) -> NewKey:
        """Replace a key by a new one with the same name and scopes; the old one is refused from now on.

        `NotFoundError`: unknown name.
        """
        with self._changing() as keys:
            made = _new(name, _named(keys, name).scopes)
            keys[name] = made.key
        return made

    def revoke(self, name: str) -> None:
        """End a key, so that it is refused from now on. `NotFoundError`: unknown name."""
        with self._changing() as keys:
            del keys[_named(keys, name).name]

    @contextmanager
    def _changing(self) -> Iterator[dict[str, AccessKey]]:
        """Yield all keys by name, and write them back, while no other process changes the file."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.with_suffix(".lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            _belong_to_service(lock.fileno(), self.path.parent)
            keys = {k.name: k for k in self.entries()}
            yield keys
            content = _KeyFile(keys=tuple(sorted(keys.values(), key=lambda k: k.name)))
            write_json(self.path, content.model_dump(mode="json"))
            with self.path.open() as written:
                os.fchmod(written.fileno(), 0o600)
                _belong_to_service(written.fileno(), self.path.parent)


def append_entry(path: Path, entry: Mapping[str, object]) -> None:
    """Append an entry to the audit log, as a complete line or not at all. OSError: the disk refuses it."""
    line = json.dumps(entry).encode() + b"\n"
    with path.open("a+b", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        if size:
            file.seek(size - 1)
            if file.read(1) != b"\n":  # A power failure has cut the last line short.
                line = b"\n" + line
        else:
            _belong_to_service(file.fileno(), path.parent)
        try:
            written = file.write(line)
            while written < len(line):
                written += file.write(line[written:])
        except OSError:
            file.truncate(size)
            raise


def note_change(path: Path, user: str, command: str, scopes: Sequence[str] = ()) -> None:
    """Write a command of a user of this machine, which has changed keys without the service, to the audit log."""
    time = datetime.now(UTC).isoformat(timespec="milliseconds")
    entry = {"time": time, "key": "none", "user": user, "address": "local", "method": "vaoi", "path": command}
    append_entry(path, {**entry, "query": ",".join(scopes)})


def _belong_to_service(handle: int, directory: Path) -> None:
    """Give a file the owner of its directory.

    The administrator makes keys as root, and the service, which owns the directory, must be able to use the files.
    """
    owner = directory.stat()
    with suppress(PermissionError):
        os.fchown(handle, owner.st_uid, owner.st_gid)


def _new(name: str, scopes: Sequence[str]) -> NewKey:
    number = secrets.token_hex(6)
    secret = f"{_PREFIX}_{number}_{secrets.token_urlsafe(32)}"
    fields = {"name": name, "id": number, "scopes": sorted(set(scopes)), "sha256": _hash(secret)}
    created = datetime.now(UTC).isoformat(timespec="seconds")
    return NewKey(parse(AccessKey, {**fields, "created": created}, "keys"), secret)


def _named(keys: dict[str, AccessKey], name: str) -> AccessKey:
    if name not in keys:
        known = ", ".join(map(repr, keys)) or "none"
        raise NotFoundError(
            f"There is no key {name!r:.80}; known keys: {known}.", action="See vaoi keys list.", code="unknown-key"
        )
    return keys[name]


def _hash(secret: str) -> str:
    # A key holds 256 random bits, so not all keys can be tried. A slow hash, as used for passwords, is therefore not
    # needed.
    return hashlib.sha256(secret.encode()).hexdigest()

"""Where an archive lies: a directory, or through fsspec an object store. Keys are relative paths with slashes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.files.directories import files_below
from vaoi_station.files.documents import write_bytes
from vaoi_station.plant.manifest import BLOBS, DRAFTS, RUNS

_TEMPORARY = re.compile(r"\.([0-9a-f]{64}|.+\.json)\.[a-z0-9_]{8}$")
"""Names of the temporary files that `write_bytes` makes of blobs and documents: `.NAME.` and what `mkstemp` appends."""


class Entry(NamedTuple):
    """One stored object."""

    key: str
    size: int
    changed: datetime


class Storage(Protocol):
    """What an archive needs of a file system or an object store: whole objects, no locks, no renames."""

    @property
    def url(self) -> str: ...  # noqa: D102
    def read(self, key: str) -> bytes: ...  # noqa: D102
    def write(self, key: str, content: bytes) -> None: ...  # noqa: D102
    def entry(self, key: str) -> Entry | None: ...  # noqa: D102
    def names(self, prefix: str) -> list[str]: ...  # noqa: D102
    def entries(self, prefix: str) -> Iterator[Entry]: ...  # noqa: D102
    def leftovers(self) -> Iterator[Entry]: ...  # noqa: D102
    def delete(self, key: str) -> None: ...  # noqa: D102


class LocalStorage:
    """A directory of this machine or of a network share."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._file_system = _file_system_of(directory)
        """Number of the file system when the archive was opened; None if the directory was absent."""

    @property
    def url(self) -> str:
        """Path of the directory."""
        return str(self._directory)

    def read(self, key: str) -> bytes:
        """Return an object; NotFoundError if it is absent, DeviceError if the disk cannot read it."""
        path = self._directory / key
        try:
            return path.read_bytes()
        except (FileNotFoundError, NotADirectoryError) as error:
            raise NotFoundError(f"{path}: there is no such file.") from error
        except OSError as error:
            raise self._unreadable(key, error) from error

    def write(self, key: str, content: bytes) -> None:
        """Write an object, on the disk when this returns; DeviceError if the disk refuses it, or is another one."""
        path = self._directory / key
        try:
            if self._file_system is not None and _file_system_of(self._directory) != self._file_system:
                raise DeviceError(
                    f"{self._directory}: is absent, or of another file system than when the archive was opened.",
                    action="Check that the share is mounted; nothing is written below its mount point.",
                    code="archive-absent",
                )
            try:
                write_bytes(path, content)
            except InputError as error:
                if not isinstance(error.__cause__, FileNotFoundError):
                    raise
                # Another process has deleted an object, and with it the directory that this one is to be in.
                write_bytes(path, content)
        except (InputError, OSError) as error:
            # Keys are those of the software: whatever refuses one is a matter of the disk, and not of the run.
            cause = error.message if isinstance(error, InputError) else f"{path}: cannot be written ({error.strerror})."
            raise DeviceError(
                cause,
                action="Check the space, the permissions and the connection of the archive.",
                code="archive-absent",
            ) from error
        if self._file_system is None:
            self._file_system = _file_system_of(self._directory)

    def entry(self, key: str) -> Entry | None:
        """Return size and time of an object; None if it is absent."""
        try:
            state = (self._directory / key).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise self._unreadable(key, error) from error
        return Entry(key, state.st_size, datetime.fromtimestamp(state.st_mtime, UTC))

    def names(self, prefix: str) -> list[str]:
        """Return the sorted names directly below a prefix; drafts of files under way are left out."""
        try:
            found = [path.name for path in (self._directory / prefix).iterdir()]
        except (FileNotFoundError, NotADirectoryError):
            return []
        except OSError as error:
            raise self._unreadable(prefix, error) from error
        return sorted(name for name in found if not name.startswith("."))

    def entries(self, prefix: str) -> Iterator[Entry]:
        """Yield all objects below a prefix."""
        for path in self._files(prefix, hidden=False):
            if (entry := self.entry(path.relative_to(self._directory).as_posix())) is not None:
                yield entry

    def leftovers(self) -> Iterator[Entry]:
        """Yield the temporary files of `write`: those under way, and those of writers that were killed."""
        # Other hidden files and folders are those of other programs, such as a trash or snapshots of the share.
        for path in chain(self._directory.glob(".*"), *(self._files(prefix) for prefix in (BLOBS, DRAFTS, RUNS))):
            *folders, name = path.relative_to(self._directory).parts
            if _TEMPORARY.match(name) and not any(folder.startswith(".") for folder in folders):
                entry = self.entry("/".join((*folders, name)))
                if entry is not None:
                    yield entry

    def _files(self, prefix: str, *, hidden: bool = True) -> Iterator[Path]:
        try:
            yield from files_below(self._directory / prefix, hidden=hidden)
        except OSError as error:
            raise self._unreadable(prefix, error) from error

    def _unreadable(self, key: str, error: OSError) -> DeviceError:
        return DeviceError(f"{self._directory / key}: cannot be read ({error.strerror}).", code="archive-absent")

    def delete(self, key: str) -> None:
        """Delete a file, if it is there, and the directory that it leaves empty."""
        path = self._directory / key
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise DeviceError(f"{path}: cannot be deleted ({error.strerror}).", code="file-not-written") from error
        with suppress(OSError):  # not empty, or another writer has just put something there
            path.parent.rmdir()


def _file_system_of(directory: Path) -> int | None:
    try:
        return directory.stat().st_dev
    except OSError:
        return None


class FsspecStorage:
    """A folder of a system that fsspec knows, for example a bucket of an S3-compatible server."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._system, self._root = _open(url)

    def read(self, key: str) -> bytes:
        """Return an object; NotFoundError if it is absent, DeviceError if the store does not answer."""
        with self._explained(key, "read", "archive-absent"):
            return bytes(self._system.cat_file(self._path(key)))

    def write(self, key: str, content: bytes) -> None:
        """Write an object by one request; DeviceError if the store refuses it."""
        with self._explained(key, "written", "file-not-written"):
            self._system.pipe_file(self._path(key), content)

    def entry(self, key: str) -> Entry | None:
        """Return size and time of an object; None if it is absent."""
        with suppress(NotFoundError), self._explained(key, "read", "archive-absent"):
            return self._entry(self._system.info(self._path(key)))
        return None

    def names(self, prefix: str) -> list[str]:
        """Return the sorted names directly below a prefix; none if it is absent."""
        found = []
        with suppress(NotFoundError), self._explained(prefix, "read", "archive-absent"):
            found = self._system.ls(self._path(prefix), detail=False)
        return sorted(str(path).rstrip("/").rpartition("/")[2] for path in found)

    def entries(self, prefix: str) -> Iterator[Entry]:
        """Yield all objects below a prefix, sorted by key."""
        found = {}
        with suppress(NotFoundError), self._explained(prefix, "read", "archive-absent"):
            found = self._system.find(self._path(prefix), detail=True)
        for path in sorted(found):
            yield self._entry(found[path])

    def leftovers(self) -> Iterator[Entry]:
        """Yield nothing: an object is written by one request, and is there as a whole or not at all."""
        return iter(())

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with suppress(NotFoundError), self._explained(key, "deleted", "file-not-written"):
            self._system.rm_file(self._path(key))

    def _path(self, key: str) -> str:
        return f"{self._root}/{key}".rstrip("/")

    def _entry(self, info: dict[str, Any]) -> Entry:
        key = str(info["name"]).strip("/").removeprefix(f"{self._root.strip('/')}/")
        changed = info.get("LastModified") or info.get("mtime") or info.get("created")
        if isinstance(changed, int | float):
            changed = datetime.fromtimestamp(changed, UTC)
        if not isinstance(changed, datetime):
            # A system without times: the object counts as just written, so that nothing is deleted too early.
            changed = datetime.now(UTC)
        return Entry(key, int(info["size"]), changed if changed.tzinfo else changed.replace(tzinfo=UTC))

    @contextmanager
    def _explained(self, key: str, done: str, code: str) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError as error:
            raise NotFoundError(f"{self.url}/{key}: there is no such object.") from error
        except Exception as error:  # Every system raises errors of its library.
            raise DeviceError(
                f"{self.url}/{key}: cannot be {done} ({type(error).__name__}: {str(error)[:200]}).",
                action="Check the address, the credentials, the space and the connection of the store.",
                code=code,
            ) from error


def _open(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError as error:
        raise InputError(
            f"{url}: archives on other systems than directories need fsspec, which is not installed.",
            action="Install vaoi-station[plant], and for s3:// vaoi-station[plant-s3].",
        ) from error
    try:
        # Other machines write too: what was listed before may be old.
        system, root = fsspec.core.url_to_fs(url, use_listings_cache=False, skip_instance_cache=True)
    except ImportError as error:
        raise InputError(
            f"{url}: fsspec needs a further package for this address ({error}).",
            action="For s3:// install vaoi-station[plant-s3].",
        ) from error
    except ValueError as error:
        raise InputError(f"{url}: is no address of an archive ({error}).") from error
    return system, str(root).rstrip("/")

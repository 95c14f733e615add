"""Where an archive lies: a directory, or through fsspec an object store. Keys are relative paths with slashes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import NamedTuple, Protocol

from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.files.directory_walk import files_below
from vaoi_station.files.documents import write_bytes
from vaoi_station.plant.archive.manifest import BLOBS, DRAFTS, RUNS

_TEMPORARY = re.compile(r"\.([0-9a-f]{64}|.+\.json)\.[a-z0-9_]{8}$")
"""Names of the temporary files that `write_bytes` makes of blobs and documents: `.NAME.` and what `mkstemp` appends."""


class Entry(NamedTuple):
    """One stored object."""

    key: str
    size: int
    changed: datetime
    """When it was written, UTC, by the clock of the storage."""


class Storage(Protocol):
    """What an archive needs of a file system or an object store: whole objects, no locks, no renames."""

    @property
    def url(self) -> str:
        """Path or address, as it is shown in messages."""

    def read(self, key: str) -> bytes:
        """Return an object; NotFoundError if it is absent, DeviceError if the storage does not answer."""

    def write(self, key: str, content: bytes) -> None:
        """Write an object so that readers see the old or the new one; DeviceError if the storage refuses it."""

    def entry(self, key: str) -> Entry | None:
        """Return size and time of an object; None if it is absent."""

    def names(self, prefix: str) -> list[str]:
        """Return the sorted names directly below a prefix, of objects and folders; none if it is absent."""

    def entries(self, prefix: str) -> Iterator[Entry]:
        """Yield all objects below a prefix, sorted by key."""

    def leftovers(self) -> Iterator[Entry]:
        """Yield the unfinished files of writers: those under way, and those of writers that were killed."""

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""


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
            raise DeviceError(f"{path}: cannot be read ({error.strerror}).", code="archive-absent") from error

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
            path = self._directory / key
            raise DeviceError(f"{path}: cannot be read ({error.strerror}).", code="archive-absent") from error
        return Entry(key, state.st_size, datetime.fromtimestamp(state.st_mtime, UTC))

    def names(self, prefix: str) -> list[str]:
        """Return the sorted names directly below a prefix; drafts of files under way are left out."""
        try:
            found = [path.name for path in (self._directory / prefix).iterdir()]
        except (FileNotFoundError, NotADirectoryError):
            return []
        except OSError as error:
            path = self._directory / prefix
            raise DeviceError(f"{path}: cannot be read ({error.strerror}).", code="archive-absent") from error
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
            path = self._directory / prefix
            raise DeviceError(f"{path}: cannot be read ({error.strerror}).", code="archive-absent") from error

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
    """Return the number of the file system of a directory; None if it is absent or does not answer."""
    try:
        return directory.stat().st_dev
    except OSError:
        return None

"""A package: one compressed tar file with named contents, and a manifest with the digest of each.

The manifest is the last member. So a package can be written in one pass, and a package that was cut short has none.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import IO, Any, Self

from vaoi_station.errors import DeviceError, GoneError, InputError
from vaoi_station.files.directories import files_below, refuse_existing, sync_directory
from vaoi_station.runs.archive.recordings import HEAD_FILE

MANIFEST = "manifest.json"
VERSION = 1
_FAST = 1
"""Level of compression: results shrink to a fifth; a higher level takes several times as long."""
_CHUNK = 1 << 20
_MOST_MEMBERS = 1_000_000
_LARGEST_MANIFEST = 200_000_000
_LARGEST_HEADER = 65_536
"""Largest extended header of a member, bytes. It holds a name or a size; `tarfile` reads it into memory as a whole."""
_EXTENDED = (
    *(tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE),
    *(tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK),
)

Entry = tuple[str, IO[bytes] | bytes]
"""Name in the package with "/" between its parts, and the open file or the content."""


def write_package(path: Path, kind: str, entries: Iterable[Entry], about: dict[str, Any]) -> int:
    """Write a package of the format `kind`, completely or not at all; return the number of its entries.

    Raises:
        InputError: the file exists, or its directory cannot be written to.
        DeviceError: the disk refuses the content.
    """
    refuse_existing(path)
    try:
        handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).", action="Choose another place.") from error
    digests: dict[str, str] = {}
    try:
        # The file has mode 0600 from mkstemp, because a backup contains all data of the station.
        with os.fdopen(handle, "wb") as file:
            with tarfile.open(fileobj=file, mode="w:gz", compresslevel=_FAST) as tar:
                for name, content in entries:
                    digests[name] = _add(tar, name, content)
                manifest = {"format": kind, "version": VERSION, **about, "sha256": digests}
                _add(tar, MANIFEST, json.dumps(manifest, indent=1).encode())
            file.flush()
            os.fsync(file.fileno())
        Path(draft).rename(path)
        sync_directory(path.parent)
    except BaseException as error:  # also after Ctrl-C: remove the draft, then raise again
        Path(draft).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise DeviceError(
                f"{path}: cannot be written ({error.strerror}).", action="Check the space of the disk."
            ) from error
        raise
    return len(digests)


def unpack_package(path: Path, kind: str, directory: Path, *, spare_bytes: int = 0) -> dict[str, Any]:
    """Unpack a package of the format `kind` into an existing directory, check every digest, and return the manifest.

    `spare_bytes` of the disk stay free: a small package may have a content of any size.

    Raises:
        DeviceError: the disk has no room for the content.
        InputError: the file is no package of this kind, is damaged or incomplete, or has unsafe names.
    """
    found: dict[str, str] = {}
    manifest: dict[str, Any] | None = None
    try:
        with tarfile.open(path, mode="r|gz", tarinfo=_BoundedHeader) as tar:
            for member in tar:
                source = tar.extractfile(member) if member.isreg() else None
                if source is None or len(found) > _MOST_MEMBERS:
                    raise InputError(f"{path}: {member.name!r} is no regular file.", action=_ACTION)
                if member.name == MANIFEST:
                    manifest = json.loads(source.read(_LARGEST_MANIFEST))
                else:
                    _refuse_without_room(path, directory, member.size, spare_bytes)
                    found[member.name] = _extract(source, _safe(path, directory, member.name))
    except (tarfile.TarError, zlib.error, EOFError, ValueError, RecursionError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise InputError(
                f"{path}: cannot be unpacked ({error.strerror}).", action="Check path and disk."
            ) from error
        raise InputError(f"{path}: is damaged, or no package ({error}).", action=_ACTION) from error
    if not isinstance(manifest, dict) or manifest.get("format") != kind:
        raise InputError(f"{path}: is no complete package of the format {kind!r}.", action=_ACTION)
    if manifest.get("version") != VERSION:
        raise InputError.field(
            path, "version", manifest.get("version"), str(VERSION), "Use the software that wrote it."
        )
    stated = manifest.get("sha256")
    expected = stated if isinstance(stated, dict) else {}
    if expected != found:
        wrong = sorted({*found} ^ {*expected} | {n for n in found if expected.get(n) != found[n]})
        raise InputError(f"{path}: {', '.join(wrong[:3])} differs from the manifest.", action=_ACTION)
    return manifest


_ACTION = "Use a file that vaoi backup or vaoi export has written, or copy it again."


class _BoundedHeader(tarfile.TarInfo):
    """A header that refuses extended headers above the limit before they are read."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """Read a header of 512 bytes; raise ValueError for an extended header that is too large."""
        header = super().frombuf(buf, encoding, errors)
        if header.type in _EXTENDED and header.size > _LARGEST_HEADER:
            raise ValueError(f"an extended header has {header.size} bytes, the limit is {_LARGEST_HEADER}")
        return header


def _add(tar: tarfile.TarFile, name: str, content: IO[bytes] | bytes) -> str:
    """Add one entry to the tar file, and return the digest of its content."""
    info = tarfile.TarInfo(name)
    if isinstance(content, bytes):
        info.size = len(content)
        tar.addfile(info, io.BytesIO(content))
        return hashlib.sha256(content).hexdigest()
    status = os.fstat(content.fileno())
    info.size, info.mtime = status.st_size, int(status.st_mtime)
    reader = _Digesting(content)
    tar.addfile(info, reader)
    return reader.summary.hexdigest()


class _Digesting:
    """A file object that computes the digest of everything that is read from it."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self.summary = file, hashlib.sha256()

    def read(self, size: int = -1) -> bytes:
        content = self._file.read(size)
        self.summary.update(content)
        return content


def _safe(path: Path, directory: Path, name: str) -> Path:
    """Return the target of a member; refuse names that lead out of the directory."""
    parts = PurePosixPath(name).parts
    if not parts or name.startswith("/") or ".." in parts or "\\" in name or "\0" in name:
        raise InputError(f"{path}: has the unsafe name {name!r}.", action=_ACTION)
    return directory.joinpath(*parts)


def _refuse_without_room(path: Path, directory: Path, needed: int, spare_bytes: int) -> None:
    free = shutil.disk_usage(directory).free - spare_bytes
    if needed > free:
        raise DeviceError(
            f"{path}: its next file has {needed / 1e6:.0f} MB, but {max(free, 0) / 1e6:.0f} MB of the disk of "
            f"{directory.parent} may be used ({spare_bytes / 1e9:g} GB stay free).",
            action="Free disk space, or unpack it on another disk.",
            code="disk-full",
        )


def _extract(source: IO[bytes], target: Path) -> str:
    target.parent.mkdir(parents=True, exist_ok=True)
    summary = hashlib.sha256()
    # Opened exclusively, because a second member with the same name must not replace the first.
    with target.open("xb") as file:
        while chunk := source.read(_CHUNK):
            summary.update(chunk)
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
    return summary.hexdigest()


def open_files(directory: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Yield the name below the directory, and the open file, of all files of a recording or reference.

    `recording.json` is the last one. The station removes a directory by a rename first (`remove_directory`), so the
    files that were listed and opened before are complete if this one is there; and what was copied without it is no
    recording.

    Raises:
        GoneError: the directory was deleted meanwhile.
    """
    last = directory / HEAD_FILE
    for path in (*(file for file in files_below(directory) if file != last), last):
        try:
            content = path.open("rb")
        except FileNotFoundError as error:
            raise GoneError(
                f"{directory}: was deleted while it was read.", action="Run the command again.", code="frames-gone"
            ) from error
        with content:
            yield path.relative_to(directory).as_posix(), content

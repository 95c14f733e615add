"""Read files of unknown origin within limits: bytes, encodings, archives, XML."""

from __future__ import annotations

import lzma
import math
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from vaoi_station.errors import InputError

MOST_BYTES = 512 * 1024 * 1024
"""Largest file and largest member of an archive that is read. The largest known file, IPC-2581 case 10, has 59 MB."""
MOST_MEMBERS = 100_000
MOST_DEPTH = 200
LARGEST_NUMBER = 1e9
"""A larger number is no length of a board in any unit; squares and products of smaller ones are finite."""
_BYTE_ORDER_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_EXPAT_NAMES = {"utf-8-sig": "UTF-8", "utf-16": "UTF-16", "utf-16-le": "UTF-16LE", "utf-16-be": "UTF-16BE"}
_HEAD_BYTES = 4096


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; refuse a file that is too large or cannot be read."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: is no file." if path.exists() else f"{path}: does not exist.")
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise InputError.field(path, "its size", f"{size} bytes", f"at most {MOST_BYTES} bytes")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from error


def head_of(data: bytes) -> bytes:
    """Return the beginning of a file by which its format is recognised; of a text in UTF-16 in UTF-8."""
    head, encoding = data[:_HEAD_BYTES], _encoding_of(data)
    return head if encoding is None else head.decode(encoding, errors="ignore").encode(errors="ignore")


def _encoding_of(data: bytes) -> str | None:
    """Return the encoding that the first bytes of a text show: by a byte order mark, or every other byte is zero."""
    for mark, encoding in _BYTE_ORDER_MARKS:
        if data.startswith(mark):
            return encoding
    zeros, first = bytes(4), data[:8]
    if (first[::2] == zeros) != (first[1::2] == zeros):
        return "utf-16-be" if first[::2] == zeros else "utf-16-le"
    return None


def decode(data: bytes, where: str | Path) -> str:
    """Return text in UTF-8, UTF-16, or Latin-1, which old CAD systems write."""
    if (encoding := _encoding_of(data)) is not None:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError as error:
            raise InputError(f"{where}: is no valid {encoding} text at byte {error.start}.") from error
    if b"\x00" in data[:_HEAD_BYTES]:
        raise InputError(f"{where}: is a binary file, not a text.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def number_of(text: object) -> float | None:
    """Return the number that a text states; None if it states none, or one that is infinite or too large."""
    try:
        found = float(text)  # type: ignore[arg-type]  # any other object is refused as well
    except (TypeError, ValueError):
        return None
    return found if math.isfinite(found) and abs(found) <= LARGEST_NUMBER else None


def parse_xml(data: bytes, where: str | Path) -> Element:
    """Parse elements and attributes of an XML file; text between the elements is left out.

    Names are without their namespace, which differs from revision to revision. A document type is refused: its entities
    could make a small file fill the memory.
    """
    builder, parser = TreeBuilder(), expat.ParserCreate(_EXPAT_NAMES.get(_encoding_of(data) or ""))
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MOST_DEPTH:
            raise InputError(f"{where}: is nested deeper than {MOST_DEPTH} levels, line {parser.CurrentLineNumber}.")
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    def refuse(*_: object) -> None:
        raise InputError(f"{where}: declares a document type (<!DOCTYPE …>), which is refused. Remove the declaration.")

    parser.StartElementHandler, parser.EndElementHandler, parser.StartDoctypeDeclHandler = start, end, refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        why = expat.errors.messages[error.code]
        raise InputError(f"{where}: not valid XML at line {error.lineno}, column {error.offset}: {why}.") from error
    except (LookupError, ValueError) as error:  # an encoding that Python does not have
        raise InputError(f"{where}: not readable as XML: {error}.") from error
    return builder.close()


@dataclass(frozen=True)
class Archive:
    """A folder, a zip file or a tar file, read member by member."""

    where: Path
    members: dict[str, Callable[[], bytes]]
    """By their relative names, with `/`, in lower case."""


# zipfile raises RuntimeError for an encrypted member, and a subclass of it for a compression it does not have. Damaged
# members raise the errors of their compression.
_UNREADABLE = (
    zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, EOFError, OSError, RuntimeError, UnicodeError,
)  # fmt: skip


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open a folder, zip or tar file; refuse one with too many members, or with paths that lead out of it."""
    try:
        if path.is_dir():
            files = islice((f for f in path.rglob("*") if f.is_file() and not f.is_symlink()), MOST_MEMBERS + 1)
            yield _archive(path, [(f.relative_to(path).as_posix(), partial(read_bytes, f)) for f in files])
        elif zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as zipped:
                # Not `is_dir`, which fails for an empty name.
                infos = [info for info in zipped.infolist() if not info.filename.endswith("/")]
                yield _archive(path, [(info.filename, partial(_unzipped, path, zipped, info)) for info in infos])
        else:
            with tarfile.open(path) as tar:
                yield _archive(path, _tar_members(path, tar))
    except _UNREADABLE as error:
        why = str(error).partition("\n")[0].rstrip(":.") or type(error).__name__
        raise InputError(
            f"{path}: is no readable folder, zip or tar file: {why}.",
            action="Copy or export it again. If it is one compressed file, unpack it first.",
        ) from error


def names_before_damage(path: Path) -> list[str]:
    """Return the names of the members of a tar file, in lower case; of a damaged one those that can still be read."""
    names: list[str] = []
    with suppress(*_UNREADABLE), tarfile.open(path) as tar:
        for member in tar:
            if len(names) < MOST_MEMBERS:
                names.append(member.name.lower())
    return names


def _archive(path: Path, members: list[tuple[str, partial[bytes]]]) -> Archive:
    if len(members) > MOST_MEMBERS:
        raise InputError.field(path, "its number of members", len(members), f"at most {MOST_MEMBERS}")
    found: dict[str, Callable[[], bytes]] = {}
    for name, read in members:
        parts = PurePosixPath(name.replace("\\", "/")).parts
        if ".." in parts or name.startswith("/"):
            raise InputError(f"{path}: member {name!r} leads out of the archive; the file is refused.")
        found["/".join(parts).lower()] = read
    return Archive(path, found)


def _limited(path: Path, name: str, size: int) -> None:
    if size > MOST_BYTES:
        raise InputError.field(f"{path}: {name}", "its size", f"{size} bytes", f"at most {MOST_BYTES} bytes")


def _unzipped(path: Path, zipped: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    _limited(path, info.filename, info.file_size)
    with zipped.open(info) as stream:
        data = stream.read(MOST_BYTES + 1)  # the size in the head may be false
    _limited(path, info.filename, len(data))
    return data


def _tar_members(path: Path, tar: tarfile.TarFile) -> list[tuple[str, partial[bytes]]]:
    found: list[tuple[str, partial[bytes]]] = []
    total = 0
    for member in tar:
        total += member.size
        _limited(path, "its content", total)
        if member.isfile() and len(found) <= MOST_MEMBERS:
            found.append((member.name, partial(_untarred, tar, member)))
    return found


def _untarred(tar: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    stream = tar.extractfile(member)
    return b"" if stream is None else stream.read()

"""Containers of a batch: multipart and zip, neither of them compressed, written member by member.

Workers pack members without knowing what precedes them. Only the directory at the end of a zip file needs the position
of every member: the station adds it while it passes the bytes on (`ContainerWriter`).
"""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Iterable
from typing import Literal, NamedTuple, get_args

ContainerName = Literal["multipart", "zip"]
CONTAINERS: tuple[ContainerName, ...] = get_args(ContainerName)
BOUNDARY = "vaoi-batch-8b1f0c5e2d7a4963"
"""Line between the parts of a multipart answer. Readers that use the length of each part need not search for it."""
MEDIA_TYPES: dict[ContainerName, str] = {
    "multipart": f"multipart/mixed; boundary={BOUNDARY}",
    "zip": "application/zip",
}
_MOST_32 = 0xFFFFFFFF
_MOST_16 = 0xFFFF
_LOCAL = struct.Struct("<4sHHHHHIIIHH")
_CENTRAL = struct.Struct("<4sHHHHHHIIIHHHHHII")
_END = struct.Struct("<4sHHHHIIH")
_END_64 = struct.Struct("<4sQHHIIQQQQ")
_LOCATOR_64 = struct.Struct("<4sIQI")
_VERSION, _VERSION_64, _UTF8 = 20, 45, 0x800


class Member(NamedTuple):
    """A file of a batch."""

    name: str
    """Path with slashes; ASCII, without parts that lead out of a folder."""
    media_type: str
    content: bytes
    headers: tuple[tuple[str, str], ...] = ()
    """Further headers in a multipart answer, such as X-Image-Width."""


class Entry(NamedTuple):
    """What the directory of a zip file states about a member."""

    name: str
    crc: int
    size: int
    offset: int
    """Position of the member in its packed bytes."""


class Packed(NamedTuple):
    """Members as bytes of a container; `entries` is empty unless the container is a zip file."""

    content: bytes
    entries: tuple[Entry, ...] = ()
    members: int = 0


def pack(container: ContainerName, members: Iterable[Member], modified_s: int) -> Packed:
    """Return members as bytes of a container. `modified_s` is the time of the files, seconds since 1970."""
    pieces: list[bytes] = []
    entries: list[Entry] = []
    size = count = 0
    for member in members:
        count += 1
        if container == "multipart":
            new = [_part_head(member), member.content, b"\r\n"]
        else:
            crc = zlib.crc32(member.content)
            entries.append(Entry(member.name, crc, len(member.content), size))
            new = [_zip_head(member, crc, modified_s), member.content]
        pieces += new
        size += sum(map(len, new))
    return Packed(b"".join(pieces), tuple(entries), count)


class ContainerWriter:
    """Joins packed members to one container."""

    def __init__(self, container: ContainerName, modified_s: int) -> None:
        self._container, self._modified_s = container, modified_s
        self._position = 0
        self._directory = bytearray()
        self.members = 0
        """Number of members so far."""

    def add(self, packed: Packed) -> bytes:
        """Return the bytes that the container continues with."""
        for entry in packed.entries:
            self._directory += _zip_entry(entry, self._position, self._modified_s)
        self._position += len(packed.content)
        self.members += packed.members
        return packed.content

    def end(self) -> bytes:
        """Return the last bytes of the container."""
        if self._container == "multipart":
            return f"--{BOUNDARY}--\r\n".encode()
        return bytes(self._directory) + _zip_end(self.members, len(self._directory), self._position)


def _part_head(member: Member) -> bytes:
    headers = (
        ("Content-Type", member.media_type),
        ("Content-Length", str(len(member.content))),
        ("Content-Disposition", f'attachment; filename="{member.name}"'),
        *member.headers,
    )
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers)
    return f"--{BOUNDARY}\r\n{lines}\r\n".encode("ascii")


def _zip_head(member: Member, crc: int, modified_s: int) -> bytes:
    name, size = member.name.encode("ascii"), len(member.content)
    clock, day = _dos_time(modified_s)
    return _LOCAL.pack(b"PK\3\4", _VERSION, _UTF8, 0, clock, day, crc, size, size, len(name), 0) + name


def _zip_entry(entry: Entry, start: int, modified_s: int) -> bytes:
    name, offset = entry.name.encode("ascii"), start + entry.offset
    clock, day = _dos_time(modified_s)
    # A position above 4 GiB stands in an extra field of 64 bits.
    extra = struct.pack("<HHQ", 1, 8, offset) if offset >= _MOST_32 else b""
    version = _VERSION_64 if extra else _VERSION
    return (
        _CENTRAL.pack(
            b"PK\1\2", version, version, _UTF8, 0, clock, day, entry.crc, entry.size, entry.size,
            len(name), len(extra), 0, 0, 0, 0, min(offset, _MOST_32),
        )
        + name
        + extra
    )  # fmt: skip


def _zip_end(members: int, size: int, offset: int) -> bytes:
    end = _END.pack(
        b"PK\5\6", 0, 0, min(members, _MOST_16), min(members, _MOST_16), min(size, _MOST_32), min(offset, _MOST_32), 0
    )
    if members < _MOST_16 and max(size, offset) < _MOST_32:
        return end
    large = _END_64.pack(b"PK\6\6", _END_64.size - 12, _VERSION_64, _VERSION_64, 0, 0, members, members, size, offset)
    return large + _LOCATOR_64.pack(b"PK\6\7", 0, offset + size, 1) + end


def _dos_time(seconds: int) -> tuple[int, int]:
    """Return time and date (UTC) as a zip file has them: steps of 2 s, from 1980 on."""
    t = time.gmtime(max(seconds, 315_532_800))
    return t.tm_hour << 11 | t.tm_min << 5 | t.tm_sec // 2, (t.tm_year - 1980) << 9 | t.tm_mon << 5 | t.tm_mday

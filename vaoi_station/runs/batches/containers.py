"""Containers of a batch: multipart and zip, neither of them compressed, written member by member.

Workers pack members without knowing what precedes them. Only the directory at the end of a zip file needs the position
of every member: the station adds it while it passes the bytes on (`ContainerWriter`).
"""

from __future__ import annotations

import io
import time
import zlib
from collections.abc import Iterable
from typing import Literal, NamedTuple, get_args
from zipfile import ZipFile, ZipInfo

ContainerName = Literal["multipart", "zip"]
CONTAINERS: tuple[ContainerName, ...] = get_args(ContainerName)
BOUNDARY = "vaoi-batch-8b1f0c5e2d7a4963"
"""Line between the parts of a multipart answer. Readers that use the length of each part need not search for it."""
MEDIA_TYPES: dict[ContainerName, str] = {
    "multipart": f"multipart/mixed; boundary={BOUNDARY}",
    "zip": "application/zip",
}
_EARLIEST_S = 315_532_800
"""Begin of 1980, the earliest time of a file in a zip file."""


class Member(NamedTuple):
    """A file of a batch."""

    name: str
    """Path with slashes; ASCII, without parts that lead out of a folder."""
    media_type: str
    content: bytes
    headers: tuple[tuple[str, str], ...] = ()
    """Further headers in a multipart answer, such as X-Image-Width."""


class Entry(NamedTuple):
    """What the directory of a zip file states about a member; `offset` is its position in its packed bytes."""

    name: str
    crc: int
    size: int
    offset: int

    def info(self, modified_s: int, start: int = 0) -> ZipInfo:
        """Return the same for `zipfile`, of a member whose packed bytes begin at `start`."""
        info = ZipInfo(self.name, time.gmtime(max(modified_s, _EARLIEST_S))[:6])
        info.CRC, info.file_size, info.compress_size = self.crc, self.size, self.size
        info.header_offset = start + self.offset
        info.external_attr = 0o644 << 16  # without a mode, unzip makes files that cannot be read
        return info


class Packed(NamedTuple):
    """Members as bytes of a container; `entries` is empty unless the container is a zip file."""

    content: bytes
    entries: tuple[Entry, ...] = ()


def pack(container: ContainerName, members: Iterable[Member], modified_s: int) -> Packed:
    """Return members as bytes of a container. `modified_s` is the time of the files, seconds since 1970."""
    pieces: list[bytes] = []
    entries: list[Entry] = []
    size = 0
    for member in members:
        if container == "multipart":
            new = [_part_head(member), member.content, b"\r\n"]
        else:
            entries.append(Entry(member.name, zlib.crc32(member.content), len(member.content), size))
            new = [entries[-1].info(modified_s).FileHeader(), member.content]
        pieces += new
        size += sum(map(len, new))
    return Packed(b"".join(pieces), tuple(entries))


class ContainerWriter:
    """Joins packed members to one container."""

    def __init__(self, container: ContainerName, modified_s: int) -> None:
        self._container, self._modified_s = container, modified_s
        self._position = 0
        self._directory: list[ZipInfo] = []

    def add(self, packed: Packed) -> bytes:
        """Return the bytes that the container continues with."""
        self._directory += [entry.info(self._modified_s, self._position) for entry in packed.entries]
        self._position += len(packed.content)
        return packed.content

    def end(self) -> bytes:
        """Return the last bytes of the container."""
        if self._container == "multipart":
            return f"--{BOUNDARY}--\r\n".encode()
        tail = _Tail(self._position)
        with ZipFile(tail, "w") as archive:
            archive.infolist().extend(self._directory)
        return bytes(tail.content)


class _Tail(io.RawIOBase):
    """The end of a file, of which a position is written already; it cannot be sought in."""

    def __init__(self, position: int) -> None:
        super().__init__()
        self._position, self.content = position, bytearray()

    def tell(self) -> int:
        return self._position + len(self.content)

    def write(self, content: bytes) -> int:  # type: ignore[override]
        self.content += content
        return len(content)


def _part_head(member: Member) -> bytes:
    headers = (
        ("Content-Type", member.media_type),
        ("Content-Length", str(len(member.content))),
        ("Content-Disposition", f'attachment; filename="{member.name}"'),
        *member.headers,
    )
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers)
    return f"--{BOUNDARY}\r\n{lines}\r\n".encode("ascii")

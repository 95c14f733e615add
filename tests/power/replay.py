"""Replays a record of file operations up to a power cut, with what a file system may lose then.

The model is that of POSIX, which file systems keep at least: data survive a power cut if their file was synced after
they were written, entries of a directory if the directory was. What was not synced is kept, lost or torn at random:
each write by itself, entries of directories in their order.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

SECTOR_BYTES = 512
"""A disk writes sectors completely or not at all."""


@dataclass(frozen=True)
class Entry:
    """One recorded operation; `end` is the size of the record behind it."""

    words: tuple[str, ...]
    data: bytes
    end: int


def read_record(record: bytes) -> Iterator[Entry]:
    """Return the operations of a record, in order."""
    at = 0
    while at < len(record):
        line_end = record.index(b"\n", at)
        kind, _, rest = record[at:line_end].decode().partition(" ")
        at = line_end + 1
        if kind == "rename":
            words = (kind, *rest.split("\t"))
        elif kind == "remove":
            words = (kind, rest)
        else:
            words = (kind, *rest.split(" ", 1)) if kind in ("make", "link", "folder") else (kind, *rest.split())
        length = int(words[3]) if kind == "write" else 0
        yield Entry(words, record[at : at + length], at + length)
        at += length


@dataclass
class Disk:
    """What has reached the disk for certain, and what waits."""

    root: str
    root_number: str
    """File number of the root directory."""
    chance: random.Random
    contents: dict[str, bytearray] = field(default_factory=dict)
    """Synced bytes by file number."""
    waiting: dict[str, list[Entry]] = field(default_factory=dict)
    """Writes and truncations that were not synced, by file number."""
    names: dict[str, str] = field(default_factory=dict)
    """Path → file number, as synced; folders have a number as well."""
    changes: list[tuple[str, ...]] = field(default_factory=list)
    """Changes of directories that were not synced, in order."""
    live: dict[str, str] = field(default_factory=dict)
    """Path → file number, as the program sees it."""

    def add(self, entry: Entry) -> None:
        """Take over one operation."""
        kind, first, *rest = entry.words
        if kind in ("write", "truncate"):
            self.waiting.setdefault(first, []).append(entry)
        elif kind == "sync":
            self._sync(first)
        else:
            if kind in ("make", "folder"):
                # A number is used again after its file was deleted.
                self.contents[first] = bytearray()
                self.waiting[first] = []
            change = (kind, first, *rest)
            _apply(self.live, change)
            self.changes.append(change)

    def cut(self, target: Path) -> None:
        """Write what is left after a power cut into an empty directory."""
        kept = dict(self.names)
        for change in self.changes[: self.chance.randint(0, len(self.changes))]:
            _apply(kept, change)
        folders = {path for path, number in kept.items() if number.startswith("d")}
        for path in sorted(folders):
            self._at(target, path).mkdir(parents=True, exist_ok=True)
        for path, number in kept.items():
            # A file whose directory is lost is lost with it.
            if path not in folders and self._at(target, path).parent.is_dir():
                self._at(target, path).write_bytes(self._left(number))

    def _at(self, target: Path, path: str) -> Path:
        return target / Path(path).relative_to(self.root)

    def _left(self, number: str) -> bytes:
        content = bytearray(self.contents.get(number, b""))
        fate = self.chance.choice(["kept", "lost", "mixed"])
        for entry in self.waiting.get(number, ()):
            if fate == "kept" or (fate == "mixed" and self.chance.random() < 0.5):
                _write(content, entry, torn=fate == "mixed" and self.chance.random() < 0.3, chance=self.chance)
        return bytes(content)

    def _sync(self, number: str) -> None:
        for entry in self.waiting.pop(number, ()):
            _write(self.contents.setdefault(number, bytearray()), entry)
        if number != self.root_number and f"d{number}" not in self.live.values():
            return
        # A journal keeps the order: with a directory, all earlier changes of directories are on the disk.
        for change in self.changes:
            _apply(self.names, change)
        self.changes.clear()


def _apply(names: dict[str, str], change: tuple[str, ...]) -> None:
    kind, first, *rest = change
    if kind in ("make", "link"):
        names[rest[0]] = first
    elif kind == "folder":
        names[rest[0]] = f"d{first}"
    elif kind == "remove":
        names.pop(first, None)
    else:
        for path in [p for p in names if p == first or p.startswith(first + "/")]:
            names[rest[0] + path.removeprefix(first)] = names.pop(path)


def _write(content: bytearray, entry: Entry, *, torn: bool = False, chance: random.Random | None = None) -> None:
    if entry.words[0] == "truncate":
        size = int(entry.words[2])
        del content[size:]
        content.extend(bytes(size - len(content)))
        return
    offset, data = int(entry.words[2]), entry.data
    if torn and chance is not None:
        data = data[: SECTOR_BYTES * chance.randint(0, len(data) // SECTOR_BYTES)]
    if len(content) < offset:
        content.extend(bytes(offset - len(content)))
    content[offset : offset + len(data)] = data

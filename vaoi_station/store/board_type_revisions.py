"""The versions of board types before they were replaced or deleted, as files below `.revisions`.

The folder is bounded. Of the versions that have to go, those go first that were in force for the shortest time: a
program that overwrites a board type again and again cannot drive out the version that was filmed with for months.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.files.durability import make_directories, sync_directory, sync_file

LATEST = "latest"
"""Name of the version that ended last: the one before the present."""
FOLDER = ".revisions"
MOST_OF_TYPE, MOST_REVISIONS, MOST_BYTES = 20, 2000, 128 * 2**20
"""Limits: versions of one board type, versions of all, and their size in all."""
_ID = re.compile(r"[0-9]{8}T[0-9]{9}Z-[0-9a-f]{8}")


class BoardTypeRevision(NamedTuple):
    """One version of a board type that is no longer in force."""

    id: str
    path: Path
    stored: datetime
    """Time at which the version was written."""
    ended: datetime
    """Time at which the version was replaced or deleted."""
    size_bytes: int

    @property
    def in_force_s(self) -> float:
        """Time for which the version was in force, s; 0 if the clock was set back meanwhile."""
        return max(0.0, (self.ended - self.stored).total_seconds())


class BoardTypeRevisions:
    """The folder with the versions of all board types. A board type is named by the stem of its file."""

    def __init__(self, directory: Path) -> None:
        self._root = directory / FOLDER

    def keep(self, path: Path) -> Path:
        """Keep the present file of a board type as a version; return its path. `DeviceError`: the disk refuses it."""
        now = datetime.now(UTC)
        try:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()[:8]
            name = f"{now:%Y%m%dT%H%M%S}{now.microsecond // 1000:03d}Z-{digest}.json"
            kept = self._root / path.stem / name
            make_directories(kept.parent)
            kept.unlink(missing_ok=True)
            try:
                os.link(path, kept)  # a link keeps the time at which the version was written
            except OSError:
                shutil.copy2(path, kept)  # the file system has no links
                sync_file(kept)
            # On the disk before what it is kept from: the file that replaces it, or its deletion.
            sync_directory(kept.parent)
        except OSError as error:
            raise DeviceError(
                f"{path}: the present version cannot be kept ({error.strerror}), so nothing was changed.",
                action="Check space and permissions of the directory of board types.",
                code="revision-not-kept",
            ) from error
        return kept

    def discard(self, kept: Path) -> None:
        """Delete a version that is not needed, because its replacement is equal to it or was not written."""
        kept.unlink(missing_ok=True)

    def bound(self, kept: Path) -> None:
        """Delete versions until the limits hold; `kept` stays."""
        own = self.list(kept.parent.name)
        for old in _to_delete([r for r in own if r.path != kept], len(own) - MOST_OF_TYPE, 0):
            old.path.unlink(missing_ok=True)
        everything = [r for stem in self.stems() for r in self.list(stem)]
        size = sum(r.size_bytes for r in everything)
        others = [r for r in everything if r.path != kept]
        for old in _to_delete(others, len(everything) - MOST_REVISIONS, size - MOST_BYTES):
            old.path.unlink(missing_ok=True)

    def stems(self) -> tuple[str, ...]:
        """Return the stems of the board types that have versions, sorted."""
        if not self._root.is_dir():
            return ()
        return tuple(sorted(folder.name for folder in self._root.iterdir() if any(folder.glob("*.json"))))

    def list(self, stem: str) -> tuple[BoardTypeRevision, ...]:
        """Return the versions of one board type, the one that ended last first."""
        found = []
        for path in (self._root / stem).glob("*.json"):
            if not _ID.fullmatch(path.stem):
                continue
            try:
                status = path.stat()
            except FileNotFoundError:
                continue  # deleted meanwhile
            ended = datetime.strptime(path.stem[:18] + "000", "%Y%m%dT%H%M%S%f").replace(tzinfo=UTC)
            stored = datetime.fromtimestamp(status.st_mtime, UTC)
            found.append(BoardTypeRevision(path.stem, path, stored, ended, status.st_size))
        return tuple(sorted(found, reverse=True))

    def get(self, stem: str, revision: str) -> BoardTypeRevision:
        """Return one version; raise `NotFoundError` if it does not exist."""
        found = next((r for r in self.list(stem) if revision in (r.id, LATEST)), None)
        if found is None:
            raise NotFoundError(
                f"There is no version {revision!r:.80} of this board type.",
                action="List its revisions; old ones are deleted when there are many.",
                code="unknown-revision",
            )
        return found


def _to_delete(revisions: Iterable[BoardTypeRevision], count: int, size: int) -> list[BoardTypeRevision]:
    """Return the versions that were in force for the shortest time: at least `count`, and `size` bytes in all."""
    chosen: list[BoardTypeRevision] = []
    for revision in sorted(revisions, key=lambda r: (r.in_force_s, r.ended)):
        if count <= 0 and size <= 0:
            break
        chosen.append(revision)
        count, size = count - 1, size - revision.size_bytes
    return chosen

"""Wait until files and names are on the disk, so that they survive a power cut."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def sync_file(path: Path) -> None:
    """Wait until the content of a file is on the disk. Its name is not: that is a part of its directory."""
    _sync(path, os.O_RDONLY)


def sync_directory(directory: Path) -> None:
    """Wait until the names in a directory are on the disk: what was created, renamed or deleted there."""
    # Some file systems (of networks, in user space) cannot sync a directory; SQLite ignores this too.
    with suppress(OSError):
        _sync(directory, os.O_RDONLY | os.O_DIRECTORY)


def sync_tree(directory: Path) -> None:
    """Wait until a directory with everything in it is on the disk."""
    for folder, _, files in os.walk(directory):
        for name in files:
            sync_file(Path(folder, name))
        sync_directory(Path(folder))


def make_directories(directory: Path) -> None:
    """Create a directory with its parents, if they are absent, and wait until their names are on the disk."""
    absent = [path for path in (directory, *directory.parents) if not path.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    for path in absent:
        sync_directory(path.parent)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

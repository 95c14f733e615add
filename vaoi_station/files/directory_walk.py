"""List the files of a directory that other processes and threads change meanwhile."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_log = logging.getLogger(__name__)


def files_below(directory: Path, *, hidden: bool = True) -> Iterator[Path]:
    """Yield the regular files below a directory, without those that are deleted meanwhile.

    A folder that is deleted during the walk counts as empty, where `Path.rglob` of Python 3.11 raises. Any other error,
    such as a folder that may not be read, is raised: otherwise files would be missing without a word.

    Args:
        directory: need not exist.
        hidden: whether to include what is below names with a leading dot, the names of unfinished work.
    """
    for folder, folders, names in os.walk(directory, onerror=_raise_unless_deleted):
        # Sorted in place, so that the walk has the same order on every file system.
        folders[:] = sorted(name for name in folders if hidden or not name.startswith("."))
        for name in sorted(names):
            path = Path(folder, name)
            if (hidden or not name.startswith(".")) and path.is_file():
                yield path


def size_below(directory: Path) -> int:
    """Return the size in bytes of the files below a directory, without those that are deleted meanwhile."""
    size = 0
    for file in files_below(directory):
        with suppress(FileNotFoundError):
            size += file.stat().st_size
    return size


def readable_size_below(directory: Path) -> int | None:
    """Return the size in bytes of the files below a directory; None, with a warning in the log, if one is unreadable.

    For directories that other users may have copied: they must keep no board from being filmed.
    """
    try:
        return size_below(directory)
    except OSError as error:
        _log.warning("%s: cannot be read (%s) and is not counted.", directory, error.strerror)
        return None


def _raise_unless_deleted(error: OSError) -> None:
    # A folder may also have been replaced by a file.
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise error

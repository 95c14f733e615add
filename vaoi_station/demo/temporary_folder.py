"""A folder for as long as a program runs; those whose program was killed are put away by the next one.

A folder is locked by its owner, and the kernel takes the lock away when that process ends, however it ends.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_NEW_S = 10.0
"""A folder that is younger may not have been locked yet."""


@contextmanager
def temporary_folder(purpose: str) -> Iterator[Path]:
    """A new folder `vaoi-PURPOSE-…` among the temporary files; gone at the end, as are those of owners that died."""
    remove_abandoned(purpose)
    folder = Path(tempfile.mkdtemp(prefix=_prefix(purpose)))
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield folder
    finally:
        shutil.rmtree(folder)
        os.close(handle)


def remove_abandoned(purpose: str) -> list[Path]:
    """Put the folders away that this user's dead programs have left; returns them."""
    found = sorted(Path(tempfile.gettempdir()).glob(f"{_prefix(purpose)}*"))
    left = [folder for folder in found if _is_left(folder)]
    for folder in left:
        shutil.rmtree(
            folder, ignore_errors=True
        )  # what its orphans still write is put away by the next remove_abandoned
    return left


def _is_left(folder: Path) -> bool:
    """Whether it is ours to put away: made by this user, not just now, and its owner is dead."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:  # no folder, a link, somebody else's, or gone meanwhile
        return False
    try:
        found = os.fstat(handle)
        if found.st_uid != os.geteuid() or time.time() - found.st_mtime < _NEW_S:
            return False
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(handle)
    return True


def _prefix(purpose: str) -> str:
    return f"vaoi-{purpose}-"

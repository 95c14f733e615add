"""A temporary folder that is removed when its program ends. Folders of killed programs are removed by the next program.

The owner locks its folder. The kernel releases the lock when the process ends, in whatever way it ends.
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

# A program locks its folder directly after it has made it; ten seconds are more than enough.
_NEW_S = 10.0
"""Age in seconds below which a folder is not removed, because its owner may not have locked it yet."""


@contextmanager
def temporary_folder(purpose: str) -> Iterator[Path]:
    """Create a folder `vaoi-PURPOSE-…` in the temporary directory, and remove it at the end of the block."""
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
    """Remove the temporary folders that killed programs of this user have left behind; return their paths."""
    found = sorted(Path(tempfile.gettempdir()).glob(f"{_prefix(purpose)}*"))
    left = [folder for folder in found if _is_abandoned(folder)]
    for folder in left:
        # Child processes of a killed program may still write files; the next call removes those.
        shutil.rmtree(folder, ignore_errors=True)
    return left


def _is_abandoned(folder: Path) -> bool:
    """Return whether a folder belongs to this user, is not new, and is no longer locked by its owner."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:  # not a folder, a symbolic link, another user's folder, or removed meanwhile
        return False
    try:
        found = os.fstat(handle)
        if found.st_uid != os.geteuid() or time.time() - found.st_mtime < _NEW_S:
            return False
        # The lock is free exactly when no process of the owner is left, whether it ended or was killed.
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(handle)
    return True


def _prefix(purpose: str) -> str:
    return f"vaoi-{purpose}-"

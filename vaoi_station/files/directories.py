"""Directories that survive a power cut: durable names, complete directories by a rename, and their files."""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vaoi_station.errors import InputError


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


def refuse_existing(*targets: Path, action: str = "Choose another path, or remove what is there.") -> None:
    """Refuse paths that exist, before the work whose outcome would be written to them.

    Raises:
        InputError: a target exists. It is an error of input like every other unsuitable path (exit code 2).
    """
    for target in targets:
        # A symbolic link whose target is absent exists too: a rename would replace the link.
        if target.exists() or target.is_symlink():
            raise InputError(f"{target}: exists already.", action=action)


@contextmanager
def new_directory(directory: Path) -> Iterator[Path]:
    """Yield a draft directory for the caller to fill. At the end rename it to `directory`; on an exception remove it.

    The directory survives a power failure with everything in it, also with files that were not written durably.

    Raises:
        InputError: the directory exists.
    """
    refuse_existing(directory)
    make_directories(directory.parent)
    # The draft is created beside the target, because a rename is atomic only within one file system.
    draft = Path(tempfile.mkdtemp(dir=directory.parent, prefix=f".{directory.name}."))
    try:
        # mkdtemp gives access to its owner only.
        draft.chmod(0o755)
        yield draft
        # Otherwise a power failure could leave the name with empty or absent files behind it.
        sync_tree(draft)
        draft.rename(directory)
        sync_directory(directory.parent)
    except BaseException:  # also after Ctrl-C: remove the draft, then raise again
        shutil.rmtree(draft, ignore_errors=True)
        raise


def remove_directory(directory: Path) -> None:
    """Remove a directory with its content. Its name vanishes at once, so no reader finds a part of the content.

    Nothing is raised. What cannot be deleted has a name with a leading dot, like the drafts of `new_directory`.
    """
    gone = directory.with_name(f".{directory.name}.deleted")
    try:
        directory.rename(gone)
    except OSError:  # e.g. a full disk takes no new name; its space is needed in any case
        gone = directory
    shutil.rmtree(gone, ignore_errors=True)


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

"""Create and remove directories by a rename, so that a complete directory has the name, or none."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.durability import make_directories, sync_directory, sync_tree


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

"""Create directories that appear complete, by a rename, or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vaoi_station.errors import StateError


@contextmanager
def new_directory(directory: Path) -> Iterator[Path]:
    """Yield a draft directory for the caller to fill. At the end rename it to `directory`; on an exception remove it.

    Raises:
        StateError: the directory exists.
    """
    if directory.exists():
        raise StateError(f"{directory}: exists already.", action="Choose another directory, or remove this one.")
    directory.parent.mkdir(parents=True, exist_ok=True)
    # The draft is created beside the target, because a rename is atomic only within one file system.
    draft = Path(tempfile.mkdtemp(dir=directory.parent, prefix=f".{directory.name}."))
    try:
        # mkdtemp gives access to its owner only.
        draft.chmod(0o755)
        yield draft
        draft.rename(directory)
    except BaseException:  # also after Ctrl-C: remove the draft, then raise again
        shutil.rmtree(draft, ignore_errors=True)
        raise

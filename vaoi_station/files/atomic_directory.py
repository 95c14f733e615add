"""Directories that appear complete, by a rename, or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vaoi_station.errors import StateError


@contextmanager
def new_directory(directory: Path) -> Iterator[Path]:
    """A draft beside a directory that is to be, for the caller to fill; nothing is left of it if that goes wrong.

    Raises:
        StateError: the directory exists.
    """
    if directory.exists():
        raise StateError(f"{directory}: exists already.", action="Choose another directory, or remove this one.")
    directory.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(dir=directory.parent, prefix=f".{directory.name}."))
    try:
        draft.chmod(0o755)
        yield draft
        draft.rename(directory)
    except BaseException:  # whatever ended it, tidy up; it is raised again
        shutil.rmtree(draft, ignore_errors=True)
        raise

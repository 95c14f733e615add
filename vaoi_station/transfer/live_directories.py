"""Recordings and references that a running station may delete while a command reads them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO

from vaoi_station.errors import GoneError
from vaoi_station.files.directories import files_below
from vaoi_station.runs.archive.recordings import HEAD_FILE


def open_files(directory: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Yield the name below the directory, and the open file, of all files of a recording or reference.

    `recording.json` is the last one. The station removes a directory by a rename first (`remove_directory`), so the
    files that were listed and opened before are complete if this one is there; and what was copied without it is no
    recording.

    Raises:
        GoneError: the directory was deleted meanwhile.
    """
    last = directory / HEAD_FILE
    for path in (*(file for file in files_below(directory) if file != last), last):
        try:
            content = path.open("rb")
        except FileNotFoundError as error:
            raise GoneError(
                f"{directory}: was deleted while it was read.", action="Run the command again.", code="frames-gone"
            ) from error
        with content:
            yield path.relative_to(directory).as_posix(), content

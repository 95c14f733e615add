"""The files by which a station is set up, and the copies that are made before one of them is replaced."""

from __future__ import annotations

import json
import os
import shlex
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from vaoi_station.config import StationConfig
from vaoi_station.errors import StateError
from vaoi_station.files.documents import write_bytes
from vaoi_station.model import Calibration

_MOST_BACKUPS = 50
"""Copies that are kept of one file; the oldest is deleted."""


@dataclass
class StationFiles:
    """The configuration in force, and the file from which it was read. No other file is named by a caller."""

    path: Path
    """station.toml."""
    config: StationConfig
    """The one in force: as it was read at the start, with the cameras that were exchanged since."""


def is_writable(path: Path) -> bool:
    """Return whether the service may replace a file."""
    # A file is replaced by renaming, so its folder decides; a protected file system refuses here too.
    folder = path.resolve().parent
    return os.access(folder, os.W_OK, effective_ids=os.access in os.supports_effective_ids)


def require_writable(path: Path) -> None:
    """Raise StateError if the service may not replace a file."""
    if not is_writable(path):
        raise StateError(
            f"{path}: the service may not write here; nothing was changed.",
            action=f"Download the new file, and put it there as administrator: {install_command(path)}",
            code="settings-read-only",
        )


def install_command(path: Path) -> str:
    """Return the command by which an administrator puts a file of the same name there."""
    return f"sudo install -b -m 640 -o root -g vaoi {shlex.quote(path.name)} {shlex.quote(str(path))}"


def restart_command(config: Path) -> str:
    """Return the command by which an administrator starts the station anew, if its configuration lets it start."""
    # A start examines the files that station.toml names, such as a scenario; one that fails would stop the line.
    return f"sudo vaoi check-config {shlex.quote(str(config))} && sudo systemctl restart vaoi-station"


def replace_with_backup(path: Path, content: bytes) -> str | None:
    """Write a file, after a copy of what it was before; return the copy's name, or None if there was no file.

    Raises:
        StateError: the service may not write there, as the unit of the package protects /etc.
        InputError: the file or its folder cannot be written to; the file is as it was.
        DeviceError: the disk is full or damaged; the file is as it was.
    """
    # Otherwise the refusal would name the copy, and another place, which the caller cannot choose.
    require_writable(path)
    path = path.resolve()
    backup = None
    if path.is_file():
        now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
        backup = path.with_name(f"{path.stem}.before-{now}{path.suffix}")
        write_bytes(backup, path.read_bytes(), mode=path.stat().st_mode & 0o777)
    write_bytes(path, content, mode=path.stat().st_mode & 0o777 if backup else 0o644)
    for old in sorted(path.parent.glob(f"{path.stem}.before-*{path.suffix}"))[:-_MOST_BACKUPS]:
        # The file is replaced already: an old copy that cannot be deleted must not look like a failure.
        with suppress(OSError):
            old.unlink()
    return None if backup is None else backup.name


def content_of(calibration: Calibration) -> bytes:
    """Return a calibration as a file."""
    document = calibration.model_dump(mode="json", exclude_none=True)
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()

"""Check the directory for the database, results and kept recordings."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, ok, warning
from vaoi_station.doctor.machine import format_bytes, nearest, writable
from vaoi_station.station import DATABASE
from vaoi_station.store.schema import VERSION

SCANT_BYTES, LITTLE_BYTES = 200e6, 2e9
"""Limits of the free space in bytes: below the first, it is a fault; below the second, a warning."""


def data(context: CheckContext) -> Iterator[Finding]:
    """Check that the data directory can be written to and has free space."""
    directory = context.config.data
    there = nearest(directory)
    if not there.is_dir():
        yield fault(f"{there} is not a directory.", "Name another directory as `data` in station.toml.")
        return
    if not writable(directory):
        yield fault(
            f"{directory} cannot be written to by this user (uid {os.geteuid()}).",
            f"chown vaoi {there}, or run vaoi doctor as the user of the service: runuser -u vaoi -- vaoi doctor …",
        )
        return
    yield judge_space(os.statvfs(there), str(directory))
    yield from database(directory / DATABASE)


def database(path: Path) -> Iterator[Finding]:
    """Check the file at the database's path without changing it, and name files that were set aside."""
    if path.exists():
        try:
            yield from _judge_database(path)
        except (sqlite3.DatabaseError, OSError) as error:
            yield fault(
                f"{path}: is not a sound database ({error}).",
                "Restore a backup, or let the station set it aside at its next start and begin anew.",
            )
    elif path.with_name(f"{path.name}.begun").exists():
        yield warning(f"{path}: there was a database, and it is gone.", "Restore a backup, if there is one.")
    for kept in sorted(path.parent.glob(f"{path.name}.damaged-*[0-9Z]")):
        yield warning(
            f"{kept}: was set aside because it was damaged.",
            f"Recover it (sqlite3 {kept.name} .recover), check the disk, then delete it.",
        )


def _judge_database(path: Path) -> Iterator[Finding]:
    if not path.is_file():
        yield fault(f"{path}: is not a regular file.", "Move it away.")
        return
    # Opened for reading only, so that no log is applied and no file is made; the station may be running.
    connection = sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True, timeout=1)
    try:
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    finally:
        connection.close()
    if version > VERSION:
        yield fault(
            f"{path}: has version {version} of the tables; this software knows versions up to {VERSION}.",
            "Start the newer vaoi_station that wrote it.",
        )
    elif tables and "runs" not in tables:
        yield fault(f"{path}: is a database of another program.", "Move it away.")


def judge_space(space: os.statvfs_result, where: str) -> Finding:
    """Judge how many bytes and inodes (entries for files) are free on a file system."""
    free = space.f_bavail * space.f_frsize
    figures: Figures = {"free_bytes": free}
    # Some file systems, such as btrfs, report no inodes at all (f_files is 0): they have no such limit.
    if space.f_files and not space.f_favail:
        return fault(
            f"{where}: no file can be created, because all inodes are in use.",
            f"Delete files; df -i {where} shows the inodes in use.",
            figures=figures,
        )
    message = f"{where}: {format_bytes(free)} free"
    if free < SCANT_BYTES:
        return fault(
            f"{message}, {format_bytes(SCANT_BYTES)} are needed.",
            f"Delete files; du -xh -d 2 {where} | sort -h lists the largest directories.",
            figures=figures,
        )
    if free < LITTLE_BYTES:
        return warning(
            f"{message}, less than {format_bytes(LITTLE_BYTES)}; kept recordings need more.",
            f"Delete files; du -xh -d 2 {where} | sort -h lists the largest directories.",
            figures=figures,
        )
    return ok(message, figures=figures)

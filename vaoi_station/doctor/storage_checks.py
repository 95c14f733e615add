"""Check the directory for the database, results and kept recordings."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from stat import S_ISREG

from vaoi_station.config import KeepConfig
from vaoi_station.doctor.finding import Figures, Finding, Level, fault, ok, warning
from vaoi_station.doctor.machine import format_bytes, nearest, writable
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.files.directories import files_below
from vaoi_station.runs.archive.recordings import DIRECTORY as RECORDINGS
from vaoi_station.runs.archive.recordings import DISK_RESERVE
from vaoi_station.runs.mosaics.kept_mosaics import DIRECTORY as MOSAICS
from vaoi_station.station import DATABASE
from vaoi_station.store.database_file import acknowledged_files
from vaoi_station.store.schema import OLDEST, VERSION

SCANT_BYTES, LITTLE_BYTES = 200e6, 2e9
"""Limits of the free space in bytes: below the first, it is a fault; below the second, a warning."""


def data(context: CheckContext) -> Iterator[Finding]:
    """Check that the data directory can be written to, and has space for all data that [keep] allows."""
    directory = context.config.data
    there = nearest(directory)
    if not there.is_dir():
        yield fault(
            "data-no-directory",
            f"{there} is not a directory.",
            "Name another directory as `data` in station.toml.",
            path=str(there),
        )
        return
    if not writable(directory):
        yield fault(
            "data-read-only",
            f"{directory} cannot be written to by this user (uid {os.geteuid()}).",
            f"chown vaoi {there}, or run vaoi doctor as the user of the service: runuser -u vaoi -- vaoi doctor …",
            path=str(directory),
        )
        return
    space = os.statvfs(there)
    finding = judge_space(space, str(directory))
    if finding.level is Level.OK:
        finding = judge_quotas(space, bytes_in_use(directory), context.config.keep, str(directory))
    yield finding
    yield from database(directory / DATABASE)


def database(path: Path) -> Iterator[Finding]:
    """Check the file at the database's path without changing it, and name files that were set aside."""
    if path.exists():
        try:
            yield from _judge_database(path)
        except (sqlite3.DatabaseError, OSError) as error:
            yield fault(
                "database-unsound",
                f"{path}: is not a sound database ({error}).",
                "Restore a backup, or let the station set it aside at its next start and begin anew.",
                path=str(path),
            )
    elif path.with_name(f"{path.name}.begun").exists():
        yield warning(
            "database-gone",
            f"{path}: there was a database, and it is gone.",
            "Restore a backup, if there is one.",
            path=str(path),
        )
    known = acknowledged_files(path)
    for kept in sorted({*path.parent.glob(f"{path.name}.damaged-*[0-9Z]")} - known):
        yield warning(
            "database-damaged",
            f"{kept}: was set aside because it was damaged.",
            f"Recover it (sqlite3 {kept.name} .recover), check the disk, then delete it.",
            path=str(kept),
        )


def _judge_database(path: Path) -> Iterator[Finding]:
    if not path.is_file():
        yield fault("database-no-file", f"{path}: is not a regular file.", "Move it away.", path=str(path))
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
            "database-newer",
            f"{path}: has version {version} of the tables; this software knows versions up to {VERSION}.",
            "Start the newer vaoi_station that wrote it.",
            path=str(path),
        )
    elif 0 < version < OLDEST:
        yield fault(
            "database-foreign",
            f"{path}: has version {version} of the tables; this software knows versions from {OLDEST} on.",
            "Restore a backup of this version, or move the file away.",
            path=str(path),
        )
    elif tables and "runs" not in tables:
        yield fault("database-foreign", f"{path}: is a database of another program.", "Move it away.", path=str(path))


def judge_space(space: os.statvfs_result, where: str) -> Finding:
    """Judge how many bytes and inodes (entries for files) are free on a file system."""
    free = space.f_bavail * space.f_frsize
    figures: Figures = {"free_bytes": free}
    # Some file systems, such as btrfs, report no inodes at all (f_files is 0): they have no such limit.
    if space.f_files and not space.f_favail:
        return fault(
            "inodes-used-up",
            f"{where}: no file can be created, because all inodes are in use.",
            f"Delete files; df -i {where} shows the inodes in use.",
            **figures,
        )
    message = f"{where}: {format_bytes(free)} free"
    if free < SCANT_BYTES:
        return fault(
            "disk-space-short",
            f"{message}, {format_bytes(SCANT_BYTES)} are needed.",
            f"Delete files; du -xh -d 2 {where} | sort -h lists the largest directories.",
            **figures,
        )
    if free < LITTLE_BYTES:
        return warning(
            "disk-space-short",
            f"{message}, less than {format_bytes(LITTLE_BYTES)}; kept recordings need more.",
            f"Delete files; du -xh -d 2 {where} | sort -h lists the largest directories.",
            **figures,
        )
    return ok(message, **figures)


def bytes_in_use(directory: Path) -> int:
    """Return the size of database, its log, recordings and pictures of boards in a data directory, in bytes."""
    kept = (path for name in (RECORDINGS, MOSAICS) for path in files_below(directory / name))
    files = (directory / DATABASE, directory / f"{DATABASE}-wal", *kept)
    sizes = []
    for path in files:
        # Files of a running station may be deleted meanwhile.
        with suppress(OSError):
            status = path.lstat()
            sizes.append(status.st_size if S_ISREG(status.st_mode) else 0)
    return sum(sizes)


def judge_quotas(space: os.statvfs_result, used_bytes: int, keep: KeepConfig, where: str) -> Finding:
    """Judge whether a disk holds what [keep] allows: database and recordings with their reserve; `used_bytes` count."""
    free = space.f_bavail * space.f_frsize
    recordings = keep.recordings_gb * 1e9
    needed = (keep.database_gb + keep.mosaics_gb) * 1e9 + (recordings + DISK_RESERVE if recordings else 0)
    figures: Figures = {"free_bytes": free, "used_bytes": used_bytes, "quota_bytes": needed}
    if free + used_bytes >= needed:
        return ok(f"{where}: {format_bytes(free)} free", **figures)
    allowed = f"{keep.database_gb:g} GB for the database, {keep.mosaics_gb:g} GB for pictures of boards" + (
        f", {keep.recordings_gb:g} GB for recordings and {format_bytes(DISK_RESERVE)} as a reserve"
        if recordings
        else ""
    )
    short = needed - free - used_bytes
    return warning(
        "disk-below-quotas",
        f"{where}: {format_bytes(free)} free and {format_bytes(used_bytes)} in use by the station are "
        f"{format_bytes(short)} less than [keep] allows ({allowed}): recordings, then old runs, will be deleted "
        "before their time.",
        "Lower [keep] database_gb or recordings_gb in station.toml, or move `data` to a larger disk.",
        **figures,
    )

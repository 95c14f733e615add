"""The directory for database, results and kept recordings."""

from __future__ import annotations

import os
from collections.abc import Iterator

from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, ok, warning
from vaoi_station.doctor.machine import format_bytes, nearest, writable

SCANT_BYTES, LITTLE_BYTES = 200e6, 2e9
"""Below the first a day's results may not fit; below the second no recordings."""


def data(context: CheckContext) -> Iterator[Finding]:
    """Can it be written to, and is there room?"""
    directory = context.config.data
    there = nearest(directory)
    if not there.is_dir():
        yield fault(f"{there} is not a directory.", "Name another one as `data` in station.toml.")
        return
    if not writable(directory):
        yield fault(
            f"{directory} cannot be written to by this user (uid {os.geteuid()}).",
            f"chown vaoi {there}, or run vaoi doctor as the user of the service: sudo -u vaoi vaoi doctor …",
        )
        return
    yield judge_space(os.statvfs(there), str(directory))


def judge_space(space: os.statvfs_result, where: str) -> Finding:
    """Bytes and files that are left."""
    free = space.f_bavail * space.f_frsize
    figures: Figures = {"free_bytes": free}
    if space.f_files and not space.f_favail:
        return fault(f"{where}: no file can be made, all inodes are in use.", f"df -i {where}", figures=figures)
    told = f"{where}: {format_bytes(free)} free"
    if free < SCANT_BYTES:
        return fault(
            f"{told}, {format_bytes(SCANT_BYTES)} are needed.", f"du -xh -d 2 {where} | sort -h", figures=figures
        )
    if free < LITTLE_BYTES:
        return warning(f"{told}; kept recordings need more.", f"du -xh -d 2 {where} | sort -h", figures=figures)
    return ok(told, figures=figures)

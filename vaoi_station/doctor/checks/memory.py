"""Check that the ring fits in memory and may be locked there."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator

from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import format_bytes, is_directory, writable

_SMALLER = "Lower [ring] runs or [line] longest_board_mm in station.toml"
_LOCK = (
    "Set LimitMEMLOCK=infinity for the service, as in deploy/vaoi-station.service; in a root shell: ulimit -l unlimited"
)


def ring_space(context: CheckContext) -> Iterator[Finding]:
    """Check that the ring of this configuration fits its directory and the machine's memory."""
    directory, needed = context.config.ring.directory, context.layout.file_bytes
    if not is_directory(directory):
        yield fault(
            f"there is no directory {directory} for the ring.",
            "mount -t tmpfs tmpfs /dev/shm, or set [ring] directory",
            code="ring-directory",
            figures={"path": str(directory)},
        )
        return
    if context.running is not None:
        yield ok(
            f"{context.running.description} holds the ring of {format_bytes(needed)}", figures={"ring_bytes": needed}
        )
        return
    if not writable(directory):
        yield fault(
            f"{directory} cannot be written to by this user.",
            "chmod 1777 /dev/shm, or set [ring] directory",
            code="ring-directory",
            figures={"path": str(directory)},
        )
        return
    space = os.statvfs(directory)
    free, available = space.f_bavail * space.f_frsize, context.machine.available_memory()
    yield _judge_space(context, needed, free, available)
    # Not a fault: a station with simulated cameras works from a disk too, and containers often have a small /dev/shm.
    kind = context.machine.filesystem_of(directory)
    if kind not in {"tmpfs", "ramfs", "hugetlbfs", None}:
        yield warning(
            f"{directory} is on {kind}, not in memory: writing frames would wait for a disk.",
            "Set [ring] directory to /dev/shm.",
            code="ring-on-disk",
            figures={"path": str(directory)},
        )


def _judge_space(context: CheckContext, needed: int, free: int, available: int | None) -> Finding:
    """Judge the space that the ring needs on its file system, and the memory that is left for other programs."""
    layout, directory = context.layout, context.config.ring.directory
    figures: Figures = {"ring_bytes": needed, "free_bytes": free, "available_bytes": available}
    message = (
        f"the ring needs {format_bytes(needed)} ({layout.bays} runs × {layout.cameras} cameras × "
        f"{layout.slots_per_camera} rows × {format_bytes(layout.slot_bytes)})"
    )
    if free < needed:
        # The ring's pages count against the tmpfs limit; a tenth more leaves space for other programs' files.
        remount = f"mount -o remount,size={round(needed * 1.1 / 2**20) + 1}M {directory}"
        return fault(
            f"{message}; {directory} has {format_bytes(free)} free.",
            f"{remount}; or: {_SMALLER}.",
            figures=figures,
            code="ring-too-large",
        )
    if available is not None and available < needed:
        return fault(
            f"{message}; the machine has {format_bytes(available)} of memory left.",
            f"{_SMALLER}.",
            figures=figures,
            code="ring-too-large",
        )
    if available is not None and available < 1.5 * needed:
        left = format_bytes(available - needed)
        return warning(
            f"{message}; only {left} of memory remain for all other programs.",
            f"{_SMALLER}.",
            figures=figures,
            code="memory-scarce",
        )
    return ok(f"{message}; {directory} has {format_bytes(free)} free", figures=figures)


def lock_limit(context: CheckContext) -> Iterator[Finding]:
    """Check that a running station has locked its ring in memory; without one, that this user is permitted to do so."""
    needed = context.layout.file_bytes
    if context.running is not None and context.running.pid is None:
        yield not_applicable(f"{context.running.description} holds the ring; whether it is locked cannot be read")
    elif context.running is not None and context.running.pid is not None:
        yield judge_locked(context.machine.locked_bytes(context.running.pid), needed, context.running.pid)
    elif context.machine.may_lock_anything():
        yield ok("this user may lock memory without limit (CAP_IPC_LOCK)")
    else:
        yield judge_lock(resource.getrlimit(resource.RLIMIT_MEMLOCK)[0], needed)


def judge_locked(locked: int | None, needed: int, pid: int) -> Finding:
    """Judge how much memory a running station has locked."""
    figures: Figures = {"locked_bytes": locked, "ring_bytes": needed}
    if locked is not None and locked >= needed:
        return ok(f"process {pid} has locked its ring, {format_bytes(locked)}", figures=figures)
    return warning(
        f"process {pid} has not locked its ring: frames are late when memory is short.",
        _LOCK,
        figures=figures,
        code="ring-not-locked",
    )


def judge_lock(limit: int, needed: int) -> Finding:
    """Judge the limit of this user for locked memory (RLIMIT_MEMLOCK)."""
    figures: Figures = {"limit_bytes": limit, "ring_bytes": needed}
    if limit == resource.RLIM_INFINITY:
        return ok("this user may lock memory without limit", figures=figures)
    if limit >= needed:
        return ok(f"this user may lock {format_bytes(limit)} of memory", figures=figures)
    return warning(
        f"this user may lock {format_bytes(limit)} of memory, the ring has {format_bytes(needed)}: "
        "frames are late when memory is short.",
        _LOCK,
        figures=figures,
        code="lock-limit-low",
    )
